"""Images of one frame find each other in a bag, also where stamps go back or topics lack runs."""

from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.convert import convert
from made_bags import depths, image, info, MATRIX, same, SECOND, STORAGES, write
import numpy as np
import pytest

STEP = SECOND // 10
NODE, CLEAN = '/left/flexx2_camera', '/left/clean/depth_image'


def seen(stamp, time, number):
    """Return the depth of a frame, which has its number in all pixels."""
    depth = np.full((9, 7), number + 1, np.float32)
    camera = info(f'{NODE}/camera_info', stamp, depth.shape)
    return [
        (*camera[:2], time, camera[3]),
        image(f'{NODE}/depth_image_0', stamp, depth, '32FC1', time),
    ]


def there(stamp, time, number, topic=CLEAN):
    """Return the clean depth of a frame."""
    return image(topic, stamp, np.full((9, 7), number + 1, np.float32), '32FC1', time)


def numbers(recording, key='clean_depth'):
    """Return which frame's image each frame has; -1 for none."""
    images = getattr(recording, key)
    assert recording.depth[:, 0, 0].tolist() == [*range(1, len(recording.depth) + 1)]
    return [int(np.nan_to_num(each[0, 0])) - 1 for each in images]


def load(path, entries):
    """Write messages in the order in which they arrived, and read them."""
    return load_recording(write(path, sorted(entries, key=lambda entry: entry[2])))


@pytest.mark.parametrize(
    ('runs', 'expected'),
    [
        ('d dc', [-1, -1, -1, 3, 4, 5]),
        ('dc d', [0, 1, 2, -1, -1, -1]),
        ('d dc d', [-1, -1, -1, 3, 4, 5, -1, -1, -1]),
        ('c dc', [0, 1, 2]),
        ('dc c dc', [0, 1, 2, 3, 4, 5]),
    ],
)
def test_clean_depth_is_that_of_the_same_run(runs, expected, tmp_path):
    """In each run the stamps begin again; it has depth (d), clean depth (c) or both."""
    entries, frame = [], 0
    for run, topics in enumerate(runs.split()):
        for index in range(3):
            time = SECOND + (3 * run + index) * STEP
            if 'd' in topics:
                # The camera publishes a little later than what it sees.
                entries += seen(index * STEP, time + STEP // 4, frame)
            if 'c' in topics:
                entries.append(there(index * STEP, time, frame if 'd' in topics else 99))
            frame += 'd' in topics
    recording = load(tmp_path / 'bag', entries)
    assert numbers(recording) == expected
    missing = expected.count(-1)
    said = [note for note in recording.notes if ': clean_depth: ' in note]
    assert len(said) == bool(missing)
    assert not missing or f'{missing} of {len(expected)} frames have none' in said[0]


def test_images_that_arrive_in_another_order_find_their_frames(tmp_path):
    entries = []
    for index, other in enumerate([0, 2, 1, 3, 4, 5]):
        time = SECOND + index * STEP
        entries += seen(index * STEP, time, index)
        entries.append(there(other * STEP, time + 1, other, f'{NODE}/gray_image_0'))
        entries.append(there(index * STEP, time + 2, index))
    recording = load(tmp_path / 'bag', entries)
    assert numbers(recording, 'amplitude') == numbers(recording) == [0, 1, 2, 3, 4, 5]
    assert [note for note in recording.notes if 'no checksums' not in note] == []


@pytest.mark.parametrize('storage', STORAGES)
def test_frames_after_a_reset_share_a_time_in_a_converted_bag(storage, tmp_path):
    # Messages of a bag cannot go back in time: all frames after the first run have its last time.
    stamps = np.tile(np.arange(4) / 10, 3)
    given = {'depth': depths(12, 9, 7, seed=1), 'clean_depth': depths(12, 9, 7, seed=2)}
    np.savez(tmp_path / 'in.npz', **given, K=MATRIX, stamp=stamps)
    convert(tmp_path / 'in.npz', tmp_path / 'bag', storage=storage)
    recording = load_recording(tmp_path / 'bag')
    assert same(recording.clean_depth, given['clean_depth'])
    assert recording.stamp.tolist() == stamps.tolist()

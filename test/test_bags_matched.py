"""Images of one frame find each other in a bag, also where some are missing or stamps go back."""

from flexx2_sim_ros.characterize.measurement import measure
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.recording import load_recording, open_recording
from flexx2_sim_ros.recording.convert import convert
from flexx2_sim_ros.truth.observation import gray_images
from made_bags import (
    camera_entries,
    depths,
    image,
    info,
    MATRIX,
    same,
    SECOND,
    STORAGES,
    usecase,
    write,
)
import numpy as np
import pytest

STEP = SECOND // 10
NODE, CLEAN = '/left/flexx2_camera', '/left/clean/depth_image'
REFLECTIVITY = '/left/clean/reflectivity'
COUNT, SHAPE = 6, (43, 56)


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


def wall(moving):
    """Return (T, H, W) float32 metres of a wall, which comes nearer if the camera moves."""
    metres = 2.0 - 0.05 * moving * np.arange(COUNT, dtype=np.float32)
    return np.broadcast_to(metres[:, None, None], (COUNT, *SHAPE)).astype(np.float32)


def campaign_of(entries, folder):
    """Return what a diagnosis reads of a bag."""
    found = check(write(folder / 'bag', entries), None)
    assert isinstance(found, Found), found
    return read(found, None)


def without(entries, topic, frames):
    """Return entries without some images of a topic."""
    seen = -1
    left = []
    for entry in entries:
        seen += entry[0] == topic
        if entry[0] != topic or seen not in frames:
            left.append(entry)
    return left


def test_a_still_scene_needs_one_clean_image(tmp_path):
    entries = camera_entries('left', wall(False) + 0.001, wall(False))
    for topic in (CLEAN, REFLECTIVITY):
        entries = without(entries, topic, {0, 1, 3})
    data = campaign_of(entries, tmp_path)
    assert data.clean.shape == SHAPE
    assert data.truth.known is None
    np.testing.assert_allclose(data.reflectivity, 0.2, rtol=1e-6)


def test_ground_truth_of_a_moving_camera_is_unknown_where_its_image_is_missing(tmp_path):
    entries = camera_entries('left', wall(True), wall(True))
    entries = without(without(entries, CLEAN, {0}), REFLECTIVITY, {4})
    data = campaign_of(entries, tmp_path)
    assert data.clean.shape == (COUNT, *SHAPE)
    known = data.truth.known.reshape(COUNT, -1)
    assert known.all(axis=1).tolist() == [False, True, True, True, False, True]
    assert not known[[0, 4]].any()


def test_a_measurement_of_the_noise_uses_all_depth(tmp_path):
    noise = 0.004 * np.random.default_rng(1).standard_normal((COUNT, *SHAPE))
    seen = (wall(False) + 0.01 + noise).astype(np.float32)
    entries = without(camera_entries('left', seen, wall(False)), CLEAN, {0, 2})
    found = measure(write(tmp_path / 'bag', entries))
    assert found.pixels.invalid == 0
    assert found.bias_of == 'clean depth'
    assert abs(found.bias - 0.01) < 0.001


def test_missing_gray_images_do_not_darken_the_others(tmp_path):
    entries = []
    for index, frame in enumerate(wall(False)):
        stamp = SECOND + index * SECOND // 30
        entries += [
            image(f'{NODE}/depth_image_0', stamp, frame),
            info(f'{NODE}/camera_info', stamp, SHAPE),
        ]
        if index % 2:
            gray = np.full(SHAPE, 200, np.uint8)
            gray[0, 0] = 250
            entries.append(image(f'{NODE}/gray_image_0', stamp, gray, 'mono8'))
    reader = open_recording(write(tmp_path / 'bag', entries))
    (gray,) = gray_images(reader, moving=False)
    assert gray[5, 5] == 200


def test_what_changes_after_the_last_frame_does_not_matter(tmp_path):
    entries = camera_entries('left', wall(False), wall(False))
    after = SECOND * 10
    late = info(f'{NODE}/camera_info', after, SHAPE)
    late[3].k[0] += 1
    entries += [usecase(NODE, after, 'Mode_9_15fps', changed=True), late]
    reader = open_recording(write(tmp_path / 'bag', entries))
    assert reader.usecase == 'Mode_5_60fps'
    assert reader.changes == []

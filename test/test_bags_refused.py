"""Files that are no recordings, recordings that no bag can hold, and targets that exist."""

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from made_bags import depths, driver_bag, image, info, MATRIX, SECOND, write
import numpy as np
from programs import convert, refusal
import pytest

LEAST = {'depth': depths(5, 9, 7), 'K': MATRIX, 'stamp': np.arange(5) / 3}


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [
        ('nothing', None, 'got a path that does not exist'),
        ('a.mcap', b'', 'no complete message'),
        ('a.db3', b'', 'no complete message'),
        ('a.mcap', b'text', 'no complete message'),
        ('a.db3', b'text' * 500, 'no complete message'),
        ('a.bag', b'#ROSBAG V2.0', 'indexed ROS 1 bag'),
        ('folder', 'empty', r'folder: must have a \.mcap or \.db3 file, got none$'),
        ('a.npz', b'PK', 'cannot be read'),
        ('b.npz', None, 'got no file'),
    ],
)
def test_no_recording(name, content, message, tmp_path):
    path = tmp_path / name
    if content == 'empty':
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        load_recording(path)
    assert str(path) in str(caught.value)
    assert convert(path, tmp_path / 'out.mcap') == 2


def test_a_camera_info_of_another_size_is_refused(tmp_path, capsys):
    node = '/left/flexx2_camera'

    def bag(name, size):
        entries = []
        for stamp, depth in enumerate(depths(2, 12, 16)):
            entries += [
                info(f'{node}/camera_info', stamp, size),
                image(f'{node}/depth_image_0', stamp, depth),
            ]
        return write(tmp_path / name, entries)

    colour = bag('colour', (480, 640))
    said = (
        f'{node}/camera_info: size: must be that of {node}/depth_image_0, 16 x 12, got 640 x 480; '
        'flexx2 convert --calibration FILE'
    )
    assert f'{colour}: {said}' in refusal(capsys, colour, tmp_path / 'out.npz')
    assert not (tmp_path / 'out.npz').exists()
    # Of a driver that leaves the size out.
    for name, size in (('no_size', (0, 0)), ('no_height', (0, 16)), ('right', (12, 16))):
        assert load_recording(bag(name, size)).depth.shape == (2, 12, 16)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'depth': None}, 'depth: must be .*, got none; the file has K, stamp'),
        ({'depth': np.zeros((9, 7), 'f4')}, r'depth: must have .*, got \(1, 9, 7\)'),
        ({'depth': np.zeros((0, 9, 7), 'f4')}, 'depth: must .*, got '),
        ({'depth': np.full((5, 9, 7), 'x')}, 'depth: must .*, got '),
        ({'K': None}, 'K: must be .*, got none'),
        ({'K': np.eye(4)}, 'K: must be .*, got shape'),
        ({'stamp': np.arange(4.0)}, 'depth: must .*, got '),
        ({'stamp': np.full(5, np.nan)}, 'stamp: must be'),
        ({'stamp': np.full(5, 1e300)}, r'stamp: must be .*, got 1e\+300'),
        ({'stamp_ns': np.arange(5) * SECOND}, 'stamp: must be stamp_ns in seconds'),
        ({'stamp_ns': np.arange(5) / 2}, 'stamp_ns: must be .*, got dtype'),
        ({'usecase': 5}, 'usecase: must be .*, got dtype'),
        ({'clean_depth': np.zeros((9, 8))}, r'clean_depth: must have .*, got \(9, 8\)'),
        ({'clean_depth': np.zeros((4, 9, 7))}, 'clean_depth: must have .*, got'),
        ({'amplitude': np.full((9, 7), 'x')}, 'amplitude: must be .*, got dtype'),
    ],
)
def test_an_npz_file_without_depth_is_refused(changes, message, tmp_path):
    arrays = LEAST | changes
    path = tmp_path / 'in.npz'
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    with pytest.raises(InputError, match=message):
        load_recording(path)


@pytest.mark.parametrize(
    ('changes', 'options', 'message'),
    [
        ({'stamp': np.arange(5) - 1.0}, [], 'range of messages, got -1 to 3 s'),
        ({'stamp': np.arange(5) * 1e9}, [], 'range of messages, got 0 to 4e'),
        ({}, ['--camera', 'front left'], '--camera'),
        ({'camera': '7'}, [], "as in front_left, got '7'"),
    ],
)
def test_a_recording_that_a_bag_cannot_hold_is_refused(
    changes, options, message, tmp_path, capsys
):
    np.savez(tmp_path / 'in.npz', **(LEAST | changes))
    assert message in refusal(capsys, tmp_path / 'in.npz', tmp_path / 'bag', *options)
    assert [path.name for path in tmp_path.iterdir()] == ['in.npz']


@pytest.mark.parametrize('name', ['out.txt', 'out.bag', 'out.NPZ', 'out.hdf5'])
def test_a_bag_is_no_folder_with_the_name_of_a_file(name, tmp_path, capsys):
    np.savez(tmp_path / 'in.npz', **LEAST)
    said = refusal(capsys, tmp_path / 'in.npz', tmp_path / name)
    assert f'{name}: must be an .npz, .mcap or .db3 file, or a folder' in said
    assert [path.name for path in tmp_path.iterdir()] == ['in.npz']


def test_a_folder_may_have_a_point_in_its_name(tmp_path):
    np.savez(tmp_path / 'in.npz', **LEAST)
    for name in ('wall_1.5m', 'walk_2026.01.31'):
        assert convert(tmp_path / 'in.npz', tmp_path / name) == 0
        assert (tmp_path / name / 'metadata.yaml').is_file()


def test_bags_are_not_overwritten(tmp_path, capsys):
    bag = driver_bag(tmp_path / 'bag', depths(2, 5, 4))
    before = (bag / 'bag.mcap').read_bytes()
    np.savez(tmp_path / 'in.npz', **LEAST)
    assert 'got one that exists' in refusal(capsys, tmp_path / 'in.npz', bag)
    assert convert(bag, bag) == 2
    assert convert(tmp_path / 'in.npz', tmp_path / 'no' / 'folder') == 2
    assert (bag / 'bag.mcap').read_bytes() == before

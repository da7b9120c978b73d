"""Recordings in bags: the real driver's, ours and converted ones."""

import tracemalloc

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, load_scene, open_recording, recording_cameras
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_writer import BagWriter
from flexx2_sim_ros.recording.convert import convert
import made_bags
from made_bags import (
    camera_entries,
    depths,
    DISTORTION,
    DRIVER,
    driver_bag,
    driver_cloud,
    driver_entries,
    EPOCH,
    image,
    info,
    MATRIX,
    same,
    SECOND,
    STORAGES,
    unlike,
    usecase,
    write,
)
import numpy as np
import pytest

TARGETS = ('folder-mcap', 'folder-sqlite3', 'file.mcap', 'file.db3')
SUFFIX = {'mcap': '.mcap', 'sqlite3': '.db3'}
RNG = np.random.default_rng(20240717)


def contents(count=5, height=9, width=7):
    """Return recordings of all kinds."""
    depth = depths(count, height, width)
    depth[0, 0, 0] = np.nan
    depth[1, 2, 3] = 0.0
    depth.view(np.uint32)[2, 1, 1] = 0x7FC01234  # a NaN of somebody's own
    base = {'depth': depth, 'K': MATRIX, 'stamp': np.arange(count) / 30, 'usecase': 'Mode_9_30fps'}
    exact = EPOCH + np.arange(count) * 16_666_667
    return {
        'least': {'depth': depth, 'K': MATRIX, 'stamp': np.arange(count) / 3},
        'simulated': base
        | {'clean_depth': depth[0].astype('f8'), 'reflectivity': depth / 10, 'seed': 7},
        'moving': base
        | {
            'clean_depth': depth * 2,
            'reflectivity': depth[0] / 10,
            'amplitude': RNG.integers(0, 256, depth.shape, np.uint8),
        },
        'double': base
        | {
            'clean_depth': depth.astype('f8') / 3,
            'reflectivity': depth.astype('f8') / 7,
            'amplitude': np.nan_to_num(depth * 1000).astype('u2'),
        },
        'odd': base
        | {
            'clean_depth': depth.astype('f2'),
            'amplitude': depth * 1e6,
            'reflectivity': np.asfortranarray(depth),
        },
        'exact': base | {'stamp': exact / 1e9, 'stamp_ns': exact},
        'unsteady': base | {'stamp': np.array([3.0, 1.0, 1.0, 2.0, 0.0])[:count]},
        'extra': base
        | {
            'sigma': depth,
            'names': np.array(['left', 'r\xe9ight']),
            'empty': np.zeros((0, 3)),
            'pose': np.eye(4, dtype='>f8'),
            'distortion': DISTORTION,
            'camera': 'chin',
            'frame_id': 'lens',
        },
    }


@pytest.mark.parametrize(
    ('kind', 'target'),
    [
        *((kind, TARGETS[0]) for kind in contents()),
        ('unsteady', 'folder-sqlite3'),
        *(('moving', target) for target in TARGETS[1:]),
    ],
)
def test_recordings_survive_a_bag_to_the_last_bit(kind, target, tmp_path):
    np.savez(tmp_path / 'in.npz', **contents()[kind])
    storage = 'sqlite3' if target.endswith('sqlite3') else 'mcap'
    steps = []

    def note(text, share):
        steps.append((text, share))

    convert(tmp_path / 'in.npz', tmp_path / target, storage=storage, progress=note)
    ((reader, _),) = convert(tmp_path / target, tmp_path / 'out.npz', progress=note)

    for name in (target, 'out.npz'):
        shares = [share for text, share in steps if text == f'writing {name}']
        assert sorted(shares) == shares
        assert shares[-1] == 1.0
    assert reader.notes == []
    assert (tmp_path / target).is_dir() == target.startswith('folder')
    assert not list(tmp_path.glob('.*')), 'nothing is left over'
    with np.load(tmp_path / 'in.npz') as given, np.load(tmp_path / 'out.npz') as back:
        assert set(back.files) == set(given.files)
        for key in given.files:
            assert same(back[key], given[key]), key
    assert not unlike(load_recording(tmp_path / 'in.npz'), load_recording(tmp_path / target))


ODD_NAME = '#1 a?b w%41 w\xe4nd 雪'


@pytest.mark.parametrize(
    ('storage', 'name'), [('mcap', ODD_NAME), ('sqlite3', ODD_NAME), ('sqlite3', '%')]
)
def test_a_bag_lies_where_it_was_asked_for(storage, name, tmp_path):
    folder = tmp_path / name
    folder.mkdir()
    given = contents()['moving']
    np.savez(folder / 'in.npz', **given)
    bag, single = folder / name, folder / f'{name}{SUFFIX[storage]}'
    for target in (bag, single):
        convert(folder / 'in.npz', target, storage=storage)
        recording = load_recording(target)
        assert same(recording.depth, given['depth'])
        assert same(recording.amplitude, given['amplitude'])
        assert recording.notes == ()
    with BagWriter(folder / f'{name}.2', storage) as writer:
        writer.write('/a', made_bags.IMAGE, 1, b'1')
    assert [message.data for message in Bag(folder / f'{name}.2').messages()] == [b'1']
    # Nothing lies beside them under a part of the name.
    assert list(tmp_path.iterdir()) == [folder]
    assert set(folder.iterdir()) == {folder / 'in.npz', bag, single, folder / f'{name}.2'}
    assert {file.suffix for file in bag.iterdir()} == {'.yaml', single.suffix}


@pytest.mark.parametrize(('mode', 'step'), [('Mode_5_60fps', SECOND / 60), (None, SECOND / 30)])
def test_a_recording_without_stamps_survives_a_bag(mode, step, tmp_path, capsys):
    given = {'depth': depths(4, 9, 7), 'K': MATRIX} | ({} if mode is None else {'usecase': mode})
    np.savez(tmp_path / 'in.npz', **given)
    assert main(['convert', str(tmp_path / 'in.npz'), str(tmp_path / 'bag')]) == 0
    recording = load_recording(tmp_path / 'bag')
    assert same(recording.depth, given['depth'])
    assert recording.stamp_ns.tolist() == [round(index * step) for index in range(4)]
    capsys.readouterr()
    assert main(['convert', str(tmp_path / 'bag'), str(tmp_path / 'out.npz')]) == 0
    assert 'out.npz: 4 frames of camera, 7 x 9' in capsys.readouterr().err
    with np.load(tmp_path / 'out.npz') as back:
        assert set(back.files) == set(given)
        assert same(back['depth'], given['depth'])


def test_a_converted_bag_is_what_a_camera_publishes(tmp_path):
    given = contents()['moving'] | {'frame_id': 'lens'}
    np.savez(tmp_path / 'in.npz', **given)
    convert(tmp_path / 'in.npz', tmp_path / 'bag', camera='front_left')
    bag = Bag(tmp_path / 'bag')
    node = '/front_left/flexx2_camera'
    assert {topic: kind.rpartition('/')[2] for topic, kind in bag.topics.items()} == {
        f'{node}/depth_image_0': 'Image',
        f'{node}/camera_info': 'CameraInfo',
        f'{node}/gray_image_0': 'Image',
        '/front_left/clean/depth_image': 'Image',
        '/front_left/clean/camera_info': 'CameraInfo',
        '/front_left/clean/reflectivity': 'Image',
        '/front_left/recording': 'UInt8MultiArray',
        '/parameter_events': 'ParameterEvent',
    }
    messages = [
        made_bags.TYPES.deserialize_cdr(message.data, message.kind)
        for message in bag.messages({f'{node}/depth_image_0'})
    ]
    assert [message.encoding for message in messages] == ['32FC1'] * 5
    assert [message.header.stamp.nanosec for message in messages] == [
        0,
        33333333,
        66666667,
        100000000,
        133333333,
    ]
    assert {message.header.frame_id for message in messages} == {'lens'}
    for message, frame in zip(messages, given['depth'], strict=True):
        assert message.data.tobytes() == frame.tobytes()


@pytest.mark.parametrize('storage', STORAGES)
def test_real_driver(storage, tmp_path):
    depth = depths(4)
    depth[:, 3, 5] = 0.0
    recording = load_recording(driver_bag(tmp_path / 'bag', depth, storage))

    expected = depth.copy()
    expected[:, 3, 5] = np.nan
    assert same(recording.depth, expected)
    assert same(recording.K, MATRIX)
    assert recording.stamp_ns.tolist() == [EPOCH + i * 22_222_000 for i in range(4)]
    assert recording.usecase == 'Mode_5_45fps'
    assert recording.camera == 'pmd_royale_ros_camera_node'
    assert recording.clean_depth is None
    assert recording.reflectivity is None
    assert recording.amplitude.dtype == np.uint8
    assert recording.amplitude[:, 0, 0].tolist() == [0, 1, 2, 3]
    assert same(recording.extra['distortion'], DISTORTION)
    assert recording.extra['frame_id'] == 'pmd_royale_ros_camera_node_optical_frame'
    assert [note for note in recording.notes if 'no checksums' not in note] == []

    convert(tmp_path / 'bag', tmp_path / 'there.npz')
    convert(tmp_path / 'there.npz', tmp_path / 'back', storage=storage)
    for path in (tmp_path / 'there.npz', tmp_path / 'back'):
        again = load_recording(path)
        assert unlike(again, recording) == []
        assert same(again.extra['distortion'], DISTORTION)
        assert again.extra['frame_id'] == recording.extra['frame_id']
    assert recording_cameras(tmp_path / 'back') == ['pmd_royale_ros_camera_node']


def test_only_the_drivers_cloud(tmp_path):
    depth = depths(3)
    depth[1, 0, 1] = 0.0
    kept = [
        entry
        for entry in driver_entries(depth)
        if not entry[0].endswith(('depth_image_0', 'gray_image_0'))
    ]
    cloud = next(message for topic, _, _, message in kept if topic.endswith('point_cloud_0'))
    assert (cloud.width, cloud.height) == (172, 224), 'swapped, as the driver does it'
    recording = load_recording(write(tmp_path / 'bag', kept))
    depth[1, 0, 1] = np.nan
    assert same(recording.depth, depth)


def test_a_point_cloud_of_another_size_is_refused(tmp_path):
    entries = [
        info(f'{DRIVER}/camera_info', 1, (172, 224)),
        driver_cloud(f'{DRIVER}/point_cloud_0', 1, depths(1, 172, 223)[0]),
    ]
    with pytest.raises(InputError, match='point_cloud_0: size: must be 224 x 172.*got 172 x 223'):
        load_recording(write(tmp_path / 'bag', entries))


def test_two_cameras_in_one_bag(tmp_path, capsys):
    depth, clean = depths(2, 5, 4, seed=1), depths(2, 5, 4, seed=2)
    bag = write(
        tmp_path / 'bag',
        camera_entries('front_left', depth, clean)
        + camera_entries('front_right', clean, depth)
        + driver_entries(depth),
    )
    names = ['front_left', 'front_right', 'pmd_royale_ros_camera_node']
    assert recording_cameras(bag) == names
    with pytest.raises(InputError, match='front_left, front_right.*got several cameras'):
        load_recording(bag)
    with pytest.raises(InputError, match="front_left, front_right.*got 'chin'"):
        load_recording(bag, 'chin')
    left, right = load_recording(bag, 'front_left'), load_recording(bag, 'front_right')
    assert same(left.depth, depth)
    assert same(left.clean_depth, clean)
    assert same(left.reflectivity, clean / 10)
    assert same(right.depth, clean)
    assert left.usecase == 'Mode_5_60fps'

    assert main(['convert', str(bag), str(tmp_path / 'out.npz')]) == 0
    assert sorted(path.name for path in tmp_path.glob('*.npz')) == [
        f'out_{name}.npz' for name in names
    ]
    assert 'out_front_left.npz: 2 frames of front_left, 4 x 5, Mode_5_60fps' in (
        capsys.readouterr().err
    )
    assert main(['convert', str(bag), str(tmp_path / 'copy')]) == 2
    assert main(['convert', str(bag), str(tmp_path / 'l.db3'), '--camera', 'front_left']) == 0
    assert same(load_recording(tmp_path / 'l.db3').depth, depth)
    assert same(load_scene(tmp_path / 'out_front_left.npz').clean_depth, clean)


def test_doubtful_contents_are_reported(tmp_path):
    depth, clean = depths(6, 5, 4, seed=1), depths(6, 5, 4, seed=2)
    entries = camera_entries('left', depth, clean)
    node = '/left/flexx2_camera'
    third = SECOND + 2 * (SECOND // 60)
    entries = [
        entry
        for entry in entries
        if not (entry[0] == '/left/clean/depth_image' and entry[2] == third)
    ]
    entries.append(usecase(node, third + 1, 'Mode_9_30fps', changed=True))
    entries.append(info(f'{node}/camera_info', third + 2, (5, 4), MATRIX * 2))
    entries.sort(key=lambda entry: entry[2])
    recording = load_recording(write(tmp_path / 'bag', entries))
    assert np.isnan(recording.clean_depth[2]).all()
    assert same(np.delete(recording.clean_depth, 2, 0), np.delete(clean, 2, 0))
    assert recording.usecase == 'Mode_5_60fps'
    text = '\n'.join(recording.notes)
    assert 'clean_depth: 1 of 6 frames have none' in text
    assert 'usecase: Mode_9_30fps from about frame 3 on' in text
    assert 'K: changes at frame 3' in text
    assert 'has no checksums' in text
    assert len(recording.notes) == 4


def test_clean_depth_of_an_unknown_view_is_left_out(tmp_path):
    entries = camera_entries('left', depths(2, 5, 4), depths(2, 6, 8))
    silent = [one for one in entries if not one[0].endswith('clean/camera_info')]
    recording = load_recording(write(tmp_path / 'bag', silent))
    assert recording.clean_depth is None
    assert any('clean_depth: left out: 8 x 6' in note for note in recording.notes)


@pytest.mark.parametrize('radial', [False, True])
@pytest.mark.parametrize('size', [(43, 56), (60, 80)])
def test_clean_depth_of_another_view_is_that_of_the_cameras_pixels(size, radial, tmp_path):
    """Assert it of a slanted wall, whose depth is known at every pixel."""
    matrix = np.array([[50.0, 0, 28.0], [0, 50.5, 21.5], [0, 0, 1]])
    wider = np.array([[47.0, 0, size[1] / 2], [0, 48.0, size[0] / 2], [0, 0, 1]])

    def wall(K, shape):  # noqa: N803
        v, u = np.indices(shape)
        x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
        return 1.5 / (1 + 0.4 * x - 0.2 * y), np.sqrt(1 + x**2 + y**2)

    expected, _ = wall(matrix, (43, 56))
    clean, ray = wall(wider, size)
    given = (clean * ray if radial else clean).astype('f4')
    node = '/left/flexx2_camera'
    entries = [usecase(node, SECOND, 'radial' if radial else 'planar', name='input_depth')]
    for stamp in (SECOND, 2 * SECOND):
        entries += [
            image('/left/clean/depth_image', stamp, given),
            image('/left/clean/reflectivity', stamp, np.full(size, 0.5, 'f4')),
            info('/left/clean/camera_info', stamp, size, wider, np.zeros(5)),
            image(f'{node}/depth_image_0', stamp, expected.astype('f4')),
            info(f'{node}/camera_info', stamp, (43, 56), matrix, np.zeros(5)),
        ]
    recording = load_recording(write(tmp_path / 'bag', entries))
    seen = np.isfinite(recording.clean_depth)
    assert seen.mean() > 0.95
    np.testing.assert_allclose(
        recording.clean_depth[seen], np.broadcast_to(expected, seen.shape)[seen], rtol=1e-5
    )
    assert (recording.reflectivity[seen] == 0.5).all()
    (note,) = (note for note in recording.notes if 'looked up' in note)
    assert ('along the ray' in note) == radial


def test_chunks_add_up_to_the_recording_in_bounded_memory(tmp_path, monkeypatch):
    monkeypatch.setattr('flexx2_sim_ros.recording.mcap_index._KEPT_BYTES', 1 << 20)
    depth, clean = depths(600, 64, 80, seed=1), depths(600, 64, 80, seed=2)
    size, stamp = depth.nbytes, np.arange(600) / 60
    np.savez(tmp_path / 'in.npz', depth=depth, clean_depth=clean, K=MATRIX, stamp=stamp)
    tracemalloc.start()
    convert(tmp_path / 'in.npz', tmp_path / 'bag')
    convert(tmp_path / 'bag', tmp_path / 'out.npz')
    for path in (tmp_path / 'bag', tmp_path / 'out.npz'):
        first = 0
        for part in open_recording(path).chunks(32):
            rows = slice(first, first + len(part.depth))
            assert same(part.depth, depth[rows])
            assert same(part.clean_depth, clean[rows])
            assert same(part.stamp, stamp[rows])
            first = rows.stop
        assert first == 600
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < size, f'{peak / 1e6:.0f} MB for {2 * size / 1e6:.0f} MB of images'

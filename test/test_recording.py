"""Recordings: whole or not at all, and never unpickled."""

import io

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, load_scene, RecordingWriter
import numpy as np
import pytest

K = np.array([[210.6, 0.0, 111.5], [0.0, 212.9, 85.5], [0.0, 0.0, 1.0]])
CLEAN = np.linspace(0.5, 3.0, 30).reshape(5, 6).astype(np.float32)
CLEAN[0, 0] = np.nan


def write(path, frames, **arrays):
    """Write a recording two frames at a time."""
    with RecordingWriter(path, *frames.shape) as writer:
        for start in range(0, len(frames), 2):
            writer.add_depth(frames[start : start + 2])
        for key, value in arrays.items():
            writer.add_array(key, value)


def test_round_trip(tmp_path):
    frames = np.random.default_rng(1).normal(2, 1, (7, 5, 6)).astype(np.float32)
    frames[3, 2] = np.nan
    path = tmp_path / 'r.npz'
    arrays = {
        'clean_depth': CLEAN,
        'K': K,
        'stamp': np.arange(7) / 30,
        'usecase': 'Mode_5_30fps',
        'reflectivity': np.ones((5, 6), np.float32),
        'label': np.array(['a', 'b']),
        'mask': np.eye(3, dtype=bool),
    }
    write(path, frames, **arrays)
    with np.load(path, allow_pickle=False) as archive:
        assert set(archive.files) == {'depth', *arrays}
        assert archive['depth'].dtype == np.dtype('<f4')
        np.testing.assert_array_equal(archive['depth'], frames)
        for key, value in arrays.items():
            np.testing.assert_array_equal(archive[key], value)
    scene = load_scene(path)
    np.testing.assert_array_equal(scene.clean_depth, CLEAN)
    np.testing.assert_array_equal(scene.K, K)
    np.testing.assert_array_equal(scene.stamp, arrays['stamp'])
    np.testing.assert_array_equal(scene.reflectivity, arrays['reflectivity'])
    assert set(scene.extra) == {'depth', 'usecase', 'label', 'mask'}
    assert str(scene.extra['usecase']) == 'Mode_5_30fps'
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('existing', [False, True])
@pytest.mark.parametrize('when', ['before depth', 'amid depth', 'after depth', 'object array'])
def test_a_failure_leaves_nothing_behind(tmp_path, existing, when):
    path = tmp_path / 'r.npz'
    if existing:
        path.write_bytes(b'precious')

    def interrupted():
        with RecordingWriter(path, 4, 5, 6) as writer:
            for step in ('before depth', 'amid depth'):
                if when == step:
                    raise KeyboardInterrupt
                writer.add_depth(np.ones((2, 5, 6), np.float32))
            writer.add_array('K', K)
            if when == 'object array':
                writer.add_array('what', np.array([{}, []], dtype=object))
            raise KeyboardInterrupt

    with pytest.raises((KeyboardInterrupt, ValueError)):
        interrupted()
    assert list(tmp_path.iterdir()) == ([path] if existing else [])
    assert not existing or path.read_bytes() == b'precious'


@pytest.mark.parametrize(
    ('arrays', 'parts'),
    [
        ({'clean_depth': None}, ['clean_depth', 'must be in the file', 'K']),
        ({'K': None}, ['K', 'must be in the file', 'clean_depth']),
        ({'clean_depth': np.ones(5)}, ['clean_depth', '(5,)', '(H, W) or (T, H, W)']),
        (
            {'clean_depth': np.ones((1, 2, 3, 4))},
            ['clean_depth', '(1, 2, 3, 4)', 'must have shape'],
        ),
        ({'clean_depth': np.ones((0, 4, 4))}, ['clean_depth', '(0, 4, 4)', 'not empty']),
        ({'clean_depth': CLEAN.astype(str)}, ['clean_depth', '<U', 'numbers']),
        ({'clean_depth': np.array([[None]])}, ['pickled']),
        ({'note': np.array({'a': 1})}, ['pickled']),
        ({'K': K[:2]}, ['K', '(2, 3)', '(3, 3)']),
        ({'reflectivity': np.ones((6, 5))}, ['reflectivity', '(6, 5)', '(5, 6)']),
        ({'reflectivity': np.ones((5, 6), bool)}, ['reflectivity', 'bool', 'numbers']),
        ({'stamp': np.ones((2, 2))}, ['stamp', '(2, 2)', '(T,)']),
        ({'stamp': np.array(['now'])}, ['stamp', '<U3', 'numbers']),
    ],
    ids=str,
)
def test_wrong_contents_are_named(tmp_path, arrays, parts):
    content = {'clean_depth': CLEAN, 'K': K, **arrays}
    path = tmp_path / 'scene.npz'
    np.savez(path, **{key: value for key, value in content.items() if value is not None})
    with pytest.raises(InputError) as raised:
        load_scene(path)
    assert str(raised.value).startswith(f'{path}: ')
    assert all(part in str(raised.value) for part in parts), str(raised.value)


ARCHIVES = []
for compressed in (np.savez, np.savez_compressed):
    buffer = io.BytesIO()
    compressed(buffer, clean_depth=CLEAN, K=K, stamp=np.array([0.5]))
    ARCHIVES.append(buffer.getvalue())


@pytest.mark.parametrize('archive', ARCHIVES, ids=['stored', 'compressed'])
def test_cut_off_at_every_byte(tmp_path, archive):
    path = tmp_path / 'cut.npz'
    for length in range(len(archive)):
        path.write_bytes(archive[:length])
        with pytest.raises(InputError, match=str(path)):
            load_scene(path)
    path.write_bytes(archive)
    np.testing.assert_array_equal(load_scene(path).clean_depth, CLEAN)


@pytest.mark.parametrize('kind', ['u2', '>i4'])
def test_whole_numbers_are_millimetres(tmp_path, kind):
    depth = np.full((2, 9, 10), 1500, kind)
    depth[:, :3] = 0
    path = tmp_path / 'of_an_sdk.npz'
    np.savez(path, depth=depth, K=np.array([[9.0, 0, 4.5], [0, 9.0, 4], [0, 0, 1]]))
    recording = load_recording(path)
    assert recording.depth.dtype == np.float32
    np.testing.assert_allclose(recording.depth[:, 3:], 1.5, rtol=1e-6)
    assert np.isnan(recording.depth[:, :3]).all()
    assert any('taken for millimetres' in note for note in recording.notes)

"""HDF5 files of imitation-learning sets as recordings."""

from flexx2_sim_ros import npz_arrays
import numpy as np
from programs import converted, refusal
import pytest

h5py = pytest.importorskip('h5py')
LENS = ['--intrinsics', '20', '20', '15.5', '11.5']
DEPTH = np.random.default_rng(2).uniform(0.5, 2.0, (5, 24, 32)).astype(np.float32)
KEY = 'data/demo_0/obs/front_depth'


def written(path, **more):
    """Write a file as robomimic and its kin do."""
    with h5py.File(path, 'w') as file:
        file[KEY] = DEPTH[..., np.newaxis]
        file.create_dataset('data/demo_1/obs/front_depth', data=2 * DEPTH, compression='gzip')
        file['data/demo_0/t'] = np.arange(5) * 0.05
        file['data/demo_0/names'] = ['a', 'b']  # objects, which are not read
        for name, value in more.items():
            file[name] = value
    return path


def test_an_episode_becomes_a_recording(tmp_path):
    path = written(tmp_path / 'demos.hdf5')
    found = converted(path, '--key', f'depth={KEY}', '--key', 'stamp=data/demo_0/t', *LENS)
    np.testing.assert_array_equal(found.depth, DEPTH)
    np.testing.assert_allclose(found.stamp, np.arange(5) * 0.05)
    other = 'depth=data/demo_1/obs/front_depth'
    found = converted(path, '--key', other, '--rate', '20', *LENS)
    np.testing.assert_array_equal(found.depth, 2 * DEPTH)
    # Keys of a recording that lie in no group need no option.
    counts = (DEPTH[0] * 1000).astype(np.uint16)
    plain = written(tmp_path / 'plain.h5', depth=counts, K=np.diag([20.0, 20.0, 1.0]))
    np.testing.assert_allclose(converted(plain).depth[0], DEPTH[0], atol=1e-3)


def test_files_that_cannot_be_used_are_refused(tmp_path, capsys, monkeypatch):
    def said(path, *words):
        return refusal(capsys, path, tmp_path / 'a.npz', *words, *LENS)

    broken = tmp_path / 'broken.h5'
    broken.write_bytes(b'\x89HDF\r\n\x1a\n' + bytes(50))
    assert 'broken.h5: cannot be read' in said(broken)
    assert 'none' in said(tmp_path / 'none.h5') or 'cannot be read' in said(tmp_path / 'none.h5')
    path = written(tmp_path / 'demos.h5')
    assert f'the file has {KEY}' in said(path, '--key', 'depth=obs').replace('data/demo_0/t, ', '')
    assert 'depth: must be in the file' in said(path)
    monkeypatch.setenv(npz_arrays.LIMIT, '1')
    with h5py.File(path, 'a') as file:  # 80 MB of nothing in some bytes
        file.create_dataset('depth', (10, 1000, 2000), 'f4', chunks=True, compression='gzip')
        secret = tmp_path / 'secret.bin'
        secret.write_bytes(bytes(4 * 24 * 32))
        file.create_dataset('out', (1, 24, 32), 'f4', external=[(str(secret), 0, 4 * 24 * 32)])
        file['link'] = h5py.ExternalLink('other.h5', '/depth')
    assert 'depth: must not decompress to more than' in said(path)
    with h5py.File(path, 'a') as file:
        del file['depth']
    assert 'out: must lie in the file' in said(path, '--key', 'depth=out')
    assert 'must name a key' in said(path, '--key', 'depth=link')
    assert not (tmp_path / 'a.npz').exists()

"""Recordings that nobody vouches for: damaged, lying and huge ones, one by one and in a folder."""

import io
import os
from pathlib import Path
import tempfile
import zipfile

from flexx2_sim_ros.characterize.analysis import characterize
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.npz_arrays import LIMIT
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.opening import find_recordings
from hostile_files import little_memory, MB
import numpy as np
import pytest

SMALL = {
    'depth': np.ones((4, 6, 8), np.float32),
    'clean_depth': np.ones((6, 8), np.float32),
    'K': np.array([[9.0, 0, 3.5], [0, 9.0, 2.5], [0, 0, 1]]),
    'stamp': np.arange(4) / 30,
    'usecase': np.array('Mode_9_30fps'),
}


def member(array, shape=None, descr=None):
    """Return an array as a file, its header with another shape or dtype."""
    array = np.asarray(array)
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array)
    content = buffer.getvalue()[-array.nbytes :] if array.nbytes else b''
    header = (
        f"{{'descr': {descr or array.dtype.str!r}, 'fortran_order': False, "
        f"'shape': {array.shape if shape is None else shape}, }}\n"
    ).encode()
    return b'\x93NUMPY\x01\x00' + len(header).to_bytes(2, 'little') + header + content


def pack(path, method=zipfile.ZIP_DEFLATED, **changes):
    """Write a recording with some members replaced."""
    with zipfile.ZipFile(path, 'w', method) as archive:
        for key, value in SMALL.items():
            archive.writestr(f'{key}.npy', changes.get(key) or member(value))
        for key in changes.keys() - SMALL.keys():
            archive.writestr(f'{key}.npy', changes[key])
    return path


def damaged(path, method):
    """Write a recording and flip what its first array is compressed to."""
    pack(path, method)
    content = bytearray(path.read_bytes())
    content[60:100] = bytes(b ^ 0xFF for b in content[60:100])
    path.write_bytes(content)


def looping(path):
    """Make a link to itself."""
    path.symlink_to(path.name)


DEPTH = SMALL['depth']
BAD = {
    'lzma': lambda path: damaged(path, zipfile.ZIP_LZMA),
    'deflate': lambda path: damaged(path, zipfile.ZIP_DEFLATED),
    'code point': lambda path: pack(
        path, usecase=member(np.array([0x110000, 65], np.uint32), '()', '<U2')
    ),
    'huge shape': lambda path: pack(path, depth=member(DEPTH, '(18446744073709551616, 1)')),
    'large shape': lambda path: pack(path, depth=member(DEPTH, '(100000000, 64, 64)')),
    'objects': lambda path: pack(path, depth=member(DEPTH, descr='|O')),
    'deep header': lambda path: pack(path, depth=member(DEPTH, '(' * 3000 + ')' * 3000)),
    'empty text': lambda path: pack(
        path, usecase=member(np.zeros(0), '(9223372036854775807,)', '<U0')
    ),
    'no magic': lambda path: pack(path, depth=b'nothing'),
    'no archive': lambda path: path.write_bytes(b'PK\x03\x04 no archive'),
    'loop': looping,
    'a folder': lambda path: path.mkdir(),
    'a pipe': lambda path: os.mkfifo(path),
}


def check_refused(capsys, path, *command):
    """Assert that a command ends with one sentence that names the file."""
    assert main([*map(str, command)]) == 2, command
    error = capsys.readouterr().err
    assert str(path) in ''.join(error.splitlines()), command
    assert 'Traceback' not in error
    assert len(error) < 1500


@pytest.mark.parametrize('kind', [kind for kind in BAD if kind != 'a pipe'])
def test_a_bad_file_is_one_sentence(kind, tmp_path, capsys):
    path = tmp_path / 'bad.npz'
    BAD[kind](path)
    check_refused(capsys, path, 'convert', path, tmp_path / 'bag')
    check_refused(capsys, path, 'simulate', path, tmp_path / 'out.npz')


@pytest.mark.parametrize('kind', ['deflate', 'loop', 'a folder', 'a pipe'])
def test_a_bad_file_in_a_folder_is_one_sentence(kind, tmp_path, capsys):
    folder = tmp_path / 'boards'
    folder.mkdir()
    path = folder / 'bad.npz'
    BAD[kind](path)
    check_refused(capsys, path, 'characterize', 'fit', folder, '--jobs', 1)
    check_refused(capsys, path, 'gap', 'diagnose', folder, '--out', tmp_path / 'out', '--jobs', 1)


def test_a_subfolder_that_cannot_be_looked_into_is_named():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        locked = folder / 'locked'
        locked.mkdir(0o700)
        user = os.geteuid()
        if user == 0:
            os.seteuid(65534)
        else:
            locked.chmod(0)
        try:
            assert find_recordings(folder) == [locked]
            with pytest.raises(InputError, match='locked'):
                characterize(folder)
            with pytest.raises(InputError, match='locked.*ermission'):
                load_recording(locked)
        finally:
            os.seteuid(user)
            locked.chmod(0o700)


def claim(path, key, size):
    """Have an archive say that an array has so many bytes, in both places."""
    content = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        true = archive.getinfo(f'{key}.npy').file_size.to_bytes(4, 'little')
    assert content.count(true) == 2
    path.write_bytes(content.replace(true, size.to_bytes(4, 'little')))
    return path


def test_a_decompression_bomb_is_refused_unread(tmp_path, monkeypatch, capsys):
    path = pack(tmp_path / 'bomb.npz', more=member(np.zeros(40 * MB, np.uint8)))
    assert path.stat().st_size < MB
    monkeypatch.setenv(LIMIT, '30')
    with little_memory(20 * MB):
        assert main(['simulate', str(path), str(tmp_path / 'out.npz')]) == 2
        assert main(['convert', str(path), str(tmp_path / 'bag')]) == 2
    said = ' '.join(capsys.readouterr().err.split())
    assert said.count('must not decompress to more than 30 MB, got 40 MB') == 2
    assert said.count(LIMIT) == 2
    monkeypatch.setenv(LIMIT, '50')
    assert load_recording(path).extra['more'].shape == (40 * MB,)
    monkeypatch.setenv(LIMIT, 'much')
    with pytest.raises(InputError, match=f"{LIMIT}: must be a whole number of MB, got 'much'"):
        load_recording(path)
    monkeypatch.delenv(LIMIT)
    claim(path, 'more', 700 * MB)
    with pytest.raises(InputError, match='must not decompress to more than 512 MB, got 700 MB'):
        load_recording(path)


def test_an_archive_with_false_sizes_is_refused(tmp_path):
    path = tmp_path / 'lies.npz'
    pack(path, more=member(np.zeros(0), '(41943040,)', '|u1') + bytes(40 * MB))
    claim(path, 'more', 200)
    with little_memory(20 * MB), pytest.raises(InputError, match='lies.npz: cannot be read'):
        load_recording(path)

"""Bags that expand to far more than their size: refused, or read within bounds."""

import struct
import sys
from zlib import crc32

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.chunks import FILE_LIMIT, LIMIT
from hostile_files import little_memory, MB
import lz4.frame
from made_bags import depths, driver_bag, EPOCH, image, info, SECOND
from made_driver_bags import ros1_bag
import numpy as np
from programs import refusal
import pytest
from rosbags.rosbag2 import CompressionMode

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

COMPRESSORS = {'zstd': zstd.compress, 'lz4': lz4.frame.compress}


def bomb(path, compression, content, declared):
    """Write an MCAP file without an index, whose only chunk expands to `content`."""
    data = COMPRESSORS[compression](content)
    name = compression.encode()
    chunk = struct.pack('<QQQI', 0, 0, declared, crc32(content))
    chunk += struct.pack('<I', len(name)) + name + struct.pack('<Q', len(data)) + data
    header = struct.pack('<II', 0, 0)
    path.write_bytes(
        b'\x89MCAP0\r\n'
        + struct.pack('<BQ', 0x01, len(header))
        + header
        + struct.pack('<BQ', 0x06, len(chunk))
        + chunk
        + struct.pack('<BQ', 0x0F, 4)
        + bytes(4)
        + struct.pack('<BQ', 0x02, 20)
        + bytes(20)
        + b'\x89MCAP0\r\n'
    )
    return path


@pytest.mark.parametrize('compression', list(COMPRESSORS))
def test_a_chunk_over_the_limit_is_refused(compression, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(LIMIT, '4')
    path = bomb(tmp_path / 'bomb.mcap', compression, bytes(64 * MB), 64 * MB)
    assert path.stat().st_size < MB
    with little_memory():
        said = refusal(capsys, path, tmp_path / 'out.npz')
    assert 'bomb.mcap: a chunk must not decompress to more than 4 MB, got 64 MB' in said
    assert LIMIT in said


@pytest.mark.parametrize('compression', list(COMPRESSORS))
def test_decompression_stops_at_the_declared_size(compression, tmp_path):
    path = bomb(tmp_path / 'lies.mcap', compression, bytes(64 * MB), 100)
    with little_memory(), pytest.raises(InputError, match='lies.mcap: .* no complete message'):
        load_recording(path)


@pytest.mark.parametrize('storage', ['sqlite3', 'mcap'])
@pytest.mark.parametrize(
    ('mode', 'variable', 'what'),
    [
        (CompressionMode.MESSAGE, LIMIT, 'a message'),
        (CompressionMode.FILE, FILE_LIMIT, 'a file of the bag'),
    ],
)
def test_compressed_messages_and_files_keep_to_a_limit(
    mode, variable, what, storage, tmp_path, monkeypatch
):
    frames = depths(3, 8, 8)
    bag = driver_bag(tmp_path / 'bag', frames, storage, compression=mode)
    np.testing.assert_array_equal(load_recording(bag).depth, frames)
    monkeypatch.setenv(variable, '4')
    bomb = driver_bag(
        tmp_path / 'bomb', np.zeros((1, 2048, 2048), 'f4'), storage, compression=mode
    )
    assert sum(file.stat().st_size for file in bomb.iterdir()) < MB
    refused = pytest.raises(InputError, match=f'bomb: {what} must not .* more than 4 MB')
    with little_memory(), refused:
        load_recording(bomb)


def flat_bag(path, compression, side, count):
    """Write a ROS 1 bag of images of zeros, which compress to almost nothing."""
    zeros = np.zeros((side, side), np.float32)
    stamps = [EPOCH + number * SECOND for number in range(count)]
    return ros1_bag(
        path,
        [image('/c/depth_image_0', stamp, zeros) for stamp in stamps]
        + [info('/c/camera_info', stamp, zeros.shape) for stamp in stamps],
        compression,
    )


@pytest.mark.parametrize('compression', ['BZ2', 'LZ4'])
def test_chunks_of_ros1_keep_to_a_limit(compression, tmp_path, monkeypatch):
    monkeypatch.setenv(LIMIT, '4')
    assert len(load_recording(flat_bag(tmp_path / 'good.bag', compression, 32, 3)).depth) == 3
    path = flat_bag(tmp_path / 'bomb.bag', compression, 2048, 1)
    assert path.stat().st_size < MB
    refused = pytest.raises(InputError, match='bomb.bag: a chunk must not .* more than 4 MB')
    with little_memory(), refused:
        load_recording(path)


@pytest.mark.parametrize('storage', ['ros1', 'mcap', 'sqlite3'])
def test_all_messages_of_a_bag_keep_to_a_limit(storage, tmp_path, monkeypatch):
    monkeypatch.setenv(FILE_LIMIT, '2')
    if storage == 'ros1':
        path = flat_bag(tmp_path / 'bomb.bag', 'BZ2', 256, 16)
    else:
        mode = CompressionMode.STORAGE if storage == 'mcap' else CompressionMode.MESSAGE
        path = driver_bag(
            tmp_path / 'bomb', np.zeros((16, 256, 256), 'f4'), storage, compression=mode
        )
    with pytest.raises(InputError, match='bomb.*: the messages of a bag must not decompress'):
        load_recording(path)
    monkeypatch.setenv(FILE_LIMIT, '64')
    assert len(load_recording(path).depth) == 16

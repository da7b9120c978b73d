"""Decode depth images of ``compressed_depth_image_transport``: a header, and PNG or RVL."""

from collections.abc import Iterator
import struct
from types import SimpleNamespace
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.png import decode_gray, MOST_PIXELS
import numpy as np

SUFFIX = '/compressedDepth'
_WHOLE = ('16UC1', 'mono16')
_HEADER_BYTES = 12
_LONGEST = 10  # groups of three bits that a number of 29 bits takes


def decompress(message: Any, field: str) -> Any:
    """
    Return the image that a ``sensor_msgs/CompressedImage`` holds without loss.

    It has the fields of ``sensor_msgs/Image``. The message is of a topic whose name ends in
    `SUFFIX`, with depth of 16 bits as PNG or RVL; ``field`` is what to call it in errors, e.g. its
    topic. Raises InputError for other depth, of which the compressed images are rounded, and
    damaged or too large ones.
    """
    encoding, _, form = str(message.format).partition(';')
    if encoding not in _WHOLE or 'compressedDepth' not in form:
        raise InputError(
            f'{field}: format: must be compressedDepth of 16UC1, which is without loss, got '
            f'{shown(str(message.format))}'
        )
    content = bytes(message.data[_HEADER_BYTES:])
    pixels = decode_rvl(content, field) if 'rvl' in form else decode_gray(content, field, (16,))
    height, width = pixels.shape
    data = pixels.astype('<u2').view(np.uint8).reshape(-1)
    return SimpleNamespace(
        header=message.header,
        encoding=encoding,
        height=height,
        width=width,
        step=2 * width,
        is_bigendian=0,
        data=data,
    )


def decode_rvl(content: bytes, field: str) -> np.ndarray:
    """
    Decode RVL (Wilson, Fast Lossless Depth Image Compression, 2017) to (H, W) uint16.

    ``content`` is width and height of 32 bits, and numbers in groups of three bits; ``field`` is
    what to call it in errors. Raises InputError when it is damaged or has too many pixels.
    """
    width, height = struct.unpack_from('<II', content) if len(content) >= 8 else (0, 0)
    if not 0 < width * height <= MOST_PIXELS:
        raise InputError(
            f'{field}: size: must be 1 to {MOST_PIXELS} pixels, got {width} x {height}'
        )
    try:
        values = _numbers(content[8:])
        pixels = np.zeros(width * height, np.int64)
        for start, deltas in _runs(values, len(pixels)):
            pixels[start : start + len(deltas)] = deltas
    except (IndexError, ValueError) as error:
        raise InputError(f'{field}: data: must be RVL, got damaged data') from error
    present = pixels != 0
    # Steps from the depth before: 0, -1, 1, -2, 2 are stored as 0, 1, 2, 3, 4.
    steps = pixels[present] - 1
    pixels[present] = np.cumsum((steps >> 1) ^ -(steps & 1))
    return pixels.reshape(height, width).astype(np.uint16)


def _numbers(content: bytes) -> np.ndarray:
    # Groups of four bits, the highest of a word first: whether another follows, and three bits.
    words = np.frombuffer(content, '<u4', len(content) // 4).astype('>u4').view(np.uint8)
    groups = np.stack([words >> 4, words & 15], -1).ravel()
    ends = np.flatnonzero(groups < 8)
    starts = np.append(0, ends + 1)[:-1]
    lengths = ends - starts + 1
    if not len(ends) or lengths.max() > _LONGEST:
        raise ValueError('no number')
    places = np.arange(ends[-1] + 1) - np.repeat(starts, lengths)
    parts = (groups[: ends[-1] + 1] & 7).astype(np.int64) << (3 * places)
    return np.asarray(np.add.reduceat(parts, starts))


def _runs(values: np.ndarray, count: int) -> Iterator[tuple[int, np.ndarray]]:
    # Where each run of depths begins, and its numbers plus 1: 0 is no depth.
    pixel = place = 0
    while pixel < count:
        zeros, depths = int(values[place]), int(values[place + 1])
        numbers = values[place + 2 : place + 2 + depths]
        pixel += zeros
        if pixel + depths > count or len(numbers) < depths or not zeros + depths:
            raise ValueError('more pixels than the image has')
        yield pixel, numbers + 1
        pixel += depths
        place += 2 + depths

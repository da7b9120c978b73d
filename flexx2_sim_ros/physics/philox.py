"""
Counter-based random numbers: Philox4x32-10 and Box-Muller.

Every number is a pure function of a key (seed and camera name) and a counter (what it is for,
which pixel or edge, which stamp). So a frame's noise does not depend on the frames before it or
beside it, and another implementation, on another device, can repeat it.

Source: Salmon, Moraes, Dror, Shaw: "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

import hashlib
import math

from flexx2_sim_ros.physics.fastmath import cos_sin_turns, log
from numba import njit
import numpy as np

# Second counter word: what the numbers are for. Never renumber. Effects say their own numbers:
# `stream`, 3 to 10 and 1001 onwards.
STREAM_AXIAL = 0
STREAM_ROW_EDGES = 1
STREAM_COLUMN_EDGES = 2

_UNIT = np.float32(2.0**-32)
_HALF = np.float32(0.5)
_MINUS_TWO = np.float32(-2.0)
_SQRT_HALF = np.float32(math.sqrt(0.5))
# All of LLVM's licences but those that assume there is no NaN and no infinity.
FAST = {'contract', 'reassoc', 'arcp', 'nsz', 'afn'}


def camera_key(seed: int, name: str) -> np.ndarray:
    """
    Derive the generator's key.

    Parameters
    ----------
    seed : int
        Any whole number.
    name : str
        The camera's name; two names give unrelated keys.

    Returns
    -------
    numpy.ndarray
        Shape (2,), uint32.

    """
    digest = hashlib.blake2b(
        f'{int(seed)}/{name}'.encode(errors='surrogateescape'), digest_size=8
    ).digest()
    return np.frombuffer(digest, dtype='<u4').astype(np.uint32)


def stamp_words(stamp_ns: int) -> tuple[np.uint32, np.uint32]:
    """Split a stamp (nanoseconds, any sign) into the two counter words that carry it."""
    wrapped = int(stamp_ns) & 0xFFFFFFFFFFFFFFFF
    return np.uint32(wrapped & 0xFFFFFFFF), np.uint32(wrapped >> 32)


@njit(inline='always')
def philox4x32(c0, c1, c2, c3, k0, k1):
    """Return four uint32 for a counter of four and a key of two uint32."""
    for _ in range(10):
        low = np.uint64(0xD2511F53) * np.uint64(c0)
        high = np.uint64(0xCD9E8D57) * np.uint64(c2)
        c0 = np.uint32(high >> np.uint64(32)) ^ c1 ^ k0
        c1 = np.uint32(high)
        c2 = np.uint32(low >> np.uint64(32)) ^ c3 ^ k1
        c3 = np.uint32(low)
        k0 = np.uint32(k0 + np.uint32(0x9E3779B9))
        k1 = np.uint32(k1 + np.uint32(0xBB67AE85))
    return c0, c1, c2, c3


@njit(inline='always')
def normal_pair(u0, u1):
    """Turn two uint32 into two independent standard normals (float32, Box-Muller)."""
    radius = math.sqrt(_MINUS_TWO * log((np.float32(u0) + _HALF) * _UNIT))
    cosine, sine = cos_sin_turns(np.float32(u1) * _UNIT)
    return radius * cosine, radius * sine


@njit(cache=True, error_model='numpy', fastmath=FAST)
def fill_normals(key, stamp_low, stamp_high, stream, out):
    """
    Fill a flat float32 array with standard normals.

    Element ``i`` is number ``i % 4`` of the block whose counter is ``(i // 4, stream, stamp_low,
    stamp_high)``.
    """
    size = out.size
    blocks = size // 4
    c1 = np.uint32(stream)
    for block in range(blocks):
        u0, u1, u2, u3 = philox4x32(np.uint32(block), c1, stamp_low, stamp_high, key[0], key[1])
        i = 4 * block
        out[i], out[i + 1] = normal_pair(u0, u1)
        out[i + 2], out[i + 3] = normal_pair(u2, u3)
    if size > 4 * blocks:
        u0, u1, u2, u3 = philox4x32(np.uint32(blocks), c1, stamp_low, stamp_high, key[0], key[1])
        i = 4 * blocks
        out[i], second = normal_pair(u0, u1)
        if i + 1 < size:
            out[i + 1] = second
        if i + 2 < size:
            out[i + 2], second = normal_pair(u2, u3)


@njit(cache=True, error_model='numpy', fastmath=FAST)
def fill_uniforms(key, stamp_low, stamp_high, stream, out):
    """Fill a flat float32 array with numbers in (0, 1], counted like `fill_normals`."""
    size = out.size
    blocks = size // 4
    c1 = np.uint32(stream)
    for block in range(blocks):
        u0, u1, u2, u3 = philox4x32(np.uint32(block), c1, stamp_low, stamp_high, key[0], key[1])
        i = 4 * block
        out[i] = (np.float32(u0) + _HALF) * _UNIT
        out[i + 1] = (np.float32(u1) + _HALF) * _UNIT
        out[i + 2] = (np.float32(u2) + _HALF) * _UNIT
        out[i + 3] = (np.float32(u3) + _HALF) * _UNIT
    if size > 4 * blocks:
        u0, u1, u2, _ = philox4x32(np.uint32(blocks), c1, stamp_low, stamp_high, key[0], key[1])
        i = 4 * blocks
        out[i] = (np.float32(u0) + _HALF) * _UNIT
        if i + 1 < size:
            out[i + 1] = (np.float32(u1) + _HALF) * _UNIT
        if i + 2 < size:
            out[i + 2] = (np.float32(u2) + _HALF) * _UNIT


@njit(inline='always')
def edge_draw(key, index, stream, stamp_low, stamp_high, laplace):
    """
    Return a draw of unit variance from the block with this counter.

    A normal one, or with probability ``laplace`` a Laplacian one.
    """
    u0, u1, u2, u3 = philox4x32(
        np.uint32(index), np.uint32(stream), stamp_low, stamp_high, key[0], key[1]
    )
    draw, _ = normal_pair(u0, u1)
    if np.float32(u2) * _UNIT < laplace:
        magnitude = -log((np.float32(u3 >> np.uint32(1)) + _HALF) * (_UNIT + _UNIT)) * _SQRT_HALF
        draw = magnitude if u3 & np.uint32(1) else -magnitude
    return draw

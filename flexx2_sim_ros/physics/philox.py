"""
Counter-based random numbers, in loops; `formulas.random_numbers` makes them.

Every number is a pure function of a key (seed and camera name) and a counter (what it is for,
which pixel or edge, which stamp). So a frame's noise does not depend on the frames before it or
beside it, and another implementation, on another device, can repeat it.
"""

import hashlib

from flexx2_sim_ros.formulas import random_numbers
from flexx2_sim_ros.physics.compiled import compiled, inlined, loop
import numpy as np

# Second counter word: what the numbers are for. Never renumber. Effects say their own numbers:
# `stream`, 3 to 12 and 1001 onwards.
STREAM_AXIAL = 0
STREAM_ROW_EDGES = 1
STREAM_COLUMN_EDGES = 2

philox4x32 = compiled(random_numbers.philox4x32)
normal_pair = compiled(random_numbers.normal_pair)
_uniform = compiled(random_numbers.uniform)
_unit_draw = compiled(random_numbers.unit_draw)
# All of LLVM's licences but those that assume there is no NaN and no infinity.
FAST = {'contract', 'reassoc', 'arcp', 'nsz', 'afn'}


def camera_key(seed: int, name: str) -> np.ndarray:
    """
    Derive the generator's key, (2,) uint32, from any seed and a camera's name.

    Two names give unrelated keys.
    """
    digest = hashlib.blake2b(
        f'{int(seed)}/{name}'.encode(errors='surrogateescape'), digest_size=8
    ).digest()
    return np.frombuffer(digest, dtype='<u4').astype(np.uint32)


def stamp_words(stamp_ns: int) -> tuple[np.uint32, np.uint32]:
    """Split a stamp (nanoseconds, any sign) into the two counter words that carry it."""
    wrapped = int(stamp_ns) & 0xFFFFFFFFFFFFFFFF
    return np.uint32(wrapped & 0xFFFFFFFF), np.uint32(wrapped >> 32)


@loop(error_model='numpy', fastmath=FAST)
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


@loop(error_model='numpy', fastmath=FAST)
def fill_uniforms(key, stamp_low, stamp_high, stream, out):
    """Fill a flat float32 array with numbers in (0, 1], counted like `fill_normals`."""
    size = out.size
    blocks = size // 4
    c1 = np.uint32(stream)
    for block in range(blocks):
        u0, u1, u2, u3 = philox4x32(np.uint32(block), c1, stamp_low, stamp_high, key[0], key[1])
        i = 4 * block
        out[i] = _uniform(u0)
        out[i + 1] = _uniform(u1)
        out[i + 2] = _uniform(u2)
        out[i + 3] = _uniform(u3)
    if size > 4 * blocks:
        u0, u1, u2, _ = philox4x32(np.uint32(blocks), c1, stamp_low, stamp_high, key[0], key[1])
        i = 4 * blocks
        out[i] = _uniform(u0)
        if i + 1 < size:
            out[i + 1] = _uniform(u1)
        if i + 2 < size:
            out[i + 2] = _uniform(u2)


@inlined
def edge_draw(key, index, stream, stamp_low, stamp_high, laplace):
    """
    Return a draw of unit variance from the block with this counter.

    A normal one, or with probability ``laplace`` a Laplacian one.
    """
    u0, u1, u2, u3 = philox4x32(
        np.uint32(index), np.uint32(stream), stamp_low, stamp_high, key[0], key[1]
    )
    return _unit_draw(u0, u1, u2, u3, laplace)

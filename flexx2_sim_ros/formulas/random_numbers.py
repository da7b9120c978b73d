"""
Counter-based random numbers: Philox4x32-10 and Box-Muller.

Source: Salmon, Moraes, Dror, Shaw: "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

import math

from flexx2_sim_ros.formulas.fastmath import cos_sin_turns, log
from flexx2_sim_ros.formulas.scalars import f32, root, u32, u64
import numpy as np

_UNIT = f32(2.0**-32)
_TWO_UNITS = f32(2.0**-31)
_HALF = f32(0.5)
_MINUS_TWO = f32(-2.0)
_SQRT_HALF = f32(math.sqrt(0.5))
_BIT = u32(1)
_WORD = u64(32)
_MULTIPLY_0 = u64(0xD2511F53)
_MULTIPLY_2 = u64(0xCD9E8D57)
_ADD_0 = u32(0x9E3779B9)
_ADD_1 = u32(0xBB67AE85)


def philox4x32(
    c0: np.uint32, c1: np.uint32, c2: np.uint32, c3: np.uint32, k0: np.uint32, k1: np.uint32
) -> tuple[np.uint32, np.uint32, np.uint32, np.uint32]:
    """Return four uint32 for a counter of four and a key of two uint32."""
    for _ in range(10):
        low = _MULTIPLY_0 * u64(c0)
        high = _MULTIPLY_2 * u64(c2)
        c0 = u32(high >> _WORD) ^ c1 ^ k0
        c1 = u32(high)
        c2 = u32(low >> _WORD) ^ c3 ^ k1
        c3 = u32(low)
        k0 = u32(k0 + _ADD_0)
        k1 = u32(k1 + _ADD_1)
    return c0, c1, c2, c3


def uniform(u: np.uint32) -> float:
    """Turn a uint32 into a number in (0, 1]."""
    return (f32(u) + _HALF) * _UNIT


def normal_pair(u0: np.uint32, u1: np.uint32) -> tuple[float, float]:
    """Turn two uint32 into two independent standard normals (float32, Box-Muller)."""
    radius = root(_MINUS_TWO * log(uniform(u0)))
    cosine, sine = cos_sin_turns(f32(u1) * _UNIT)
    return radius * cosine, radius * sine


def unit_draw(u0: np.uint32, u1: np.uint32, u2: np.uint32, u3: np.uint32, laplace: float) -> float:
    """Turn four uint32 into a draw of unit variance: with probability ``laplace`` Laplacian."""
    draw, _ = normal_pair(u0, u1)
    if f32(u2) * _UNIT < laplace:
        draw = -log((f32(u3 >> _BIT) + _HALF) * _TWO_UNITS) * _SQRT_HALF
        if (u3 & _BIT) != _BIT:
            draw = -draw
    return draw

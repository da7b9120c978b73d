"""
Elementary functions in float32, made of nothing but arithmetic.

A compiler turns loops over them into vector instructions, which it cannot do with calls into the
C library, and another device repeats them to the last bits. Errors are a few float32 roundings.

Sources: Abramowitz and Stegun 4.4.46 (arc cosine) and 4.4.49 (arc tangent); the others
are Taylor series after range reduction.
"""

import math

from numba import njit
import numpy as np

_F = np.float32
_ONE = _F(1.0)
_HALF = _F(0.5)
_LN2 = _F(math.log(2.0))
_SQRT2 = _F(math.sqrt(2.0))
LOG2_TERMS = tuple(_F(2.0 / math.log(2.0) / k) for k in (1, 3, 5, 7, 9))
EXP2_TERMS = tuple(_F(math.log(2.0) ** k / math.factorial(k)) for k in range(8))
SIN_TERMS = tuple(
    _F((-1) ** k * (math.pi / 2) ** (2 * k + 1) / math.factorial(2 * k + 1)) for k in range(5)
)
COS_TERMS = tuple(
    _F((-1) ** k * (math.pi / 2) ** (2 * k) / math.factorial(2 * k)) for k in range(6)
)
ARCCOS = tuple(
    _F(value)
    for value in (
        1.5707963050,
        -0.2145988016,
        0.0889789874,
        -0.0501743046,
        0.0308918810,
        -0.0170881256,
        0.0066700901,
        -0.0012624911,
    )
)
ARCTAN = tuple(
    _F(value)
    for value in (
        -0.3333314528,
        0.1999355085,
        -0.1420889944,
        0.1065626393,
        -0.0752896400,
        0.0429096138,
        -0.0161657367,
        0.0028662257,
    )
)
_PI = _F(math.pi)
_HALF_PI = _F(math.pi / 2)


@njit(inline='always')
def arccos(c):
    """Return the arc cosine of a number in 0..1, radians."""
    a0, a1, a2, a3, a4, a5, a6, a7 = ARCCOS
    series = a0 + c * (a1 + c * (a2 + c * (a3 + c * (a4 + c * (a5 + c * (a6 + c * a7))))))
    return math.sqrt(max(_ONE - c, _F(0.0))) * series


@njit(inline='always')
def log2(x):
    """Return the binary logarithm of a positive normal number."""
    bits = _F(x).view(np.int32)
    exponent = (bits >> 23) - 127
    mantissa = np.int32((bits & 0x7FFFFF) | 0x3F800000).view(np.float32)
    large = mantissa > _SQRT2
    mantissa = mantissa * _HALF if large else mantissa
    exponent = exponent + 1 if large else exponent
    s = (mantissa - _ONE) / (mantissa + _ONE)
    s2 = s * s
    c1, c3, c5, c7, c9 = LOG2_TERMS
    return _F(exponent) + s * (c1 + s2 * (c3 + s2 * (c5 + s2 * (c7 + s2 * c9))))


@njit(inline='always')
def exp2(y):
    """Return 2 to a power in -126..127."""
    y = min(max(y, _F(-126.0)), _F(127.0))
    whole = np.floor(y + _HALF)
    f = y - whole
    e0, e1, e2, e3, e4, e5, e6, e7 = EXP2_TERMS
    series = e0 + f * (e1 + f * (e2 + f * (e3 + f * (e4 + f * (e5 + f * (e6 + f * e7))))))
    return series * np.int32((np.int32(whole) + 127) << 23).view(np.float32)


@njit(inline='always')
def power(x, exponent):
    """Return a positive number to a power."""
    return exp2(exponent * log2(x))


@njit(inline='always')
def log(x):
    """Return the natural logarithm of a positive normal number."""
    return _LN2 * log2(x)


@njit(inline='always')
def cos_sin_turns(turns):
    """Return cosine and sine of an angle given in turns, 0..1."""
    quarters = turns * _F(4.0)
    nearest = np.floor(quarters + _HALF)
    f = quarters - nearest
    f2 = f * f
    s0, s1, s2, s3, s4 = SIN_TERMS
    c0, c1, c2, c3, c4, c5 = COS_TERMS
    sine = f * (s0 + f2 * (s1 + f2 * (s2 + f2 * (s3 + f2 * s4))))
    cosine = c0 + f2 * (c1 + f2 * (c2 + f2 * (c3 + f2 * (c4 + f2 * c5))))
    quadrant = np.int32(nearest) & 3
    odd = (quadrant & 1) != 0
    first = sine if odd else cosine
    second = cosine if odd else sine
    first = -first if (quadrant == 1) | (quadrant == 2) else first
    second = -second if quadrant >= 2 else second
    return first, second


@njit(inline='always')
def arctan2(y, x):
    """Return the angle of (x, y), radians in -pi..pi; 0 for (0, 0)."""
    large = max(abs(x), abs(y))
    small = min(abs(x), abs(y))
    t = small / large if large > _F(0.0) else _F(0.0)
    t2 = t * t
    a0, a1, a2, a3, a4, a5, a6, a7 = ARCTAN
    angle = t * (
        _ONE
        + t2
        * (a0 + t2 * (a1 + t2 * (a2 + t2 * (a3 + t2 * (a4 + t2 * (a5 + t2 * (a6 + t2 * a7)))))))
    )
    angle = _HALF_PI - angle if abs(y) > abs(x) else angle
    angle = _PI - angle if x < _F(0.0) else angle
    return -angle if y < _F(0.0) else angle

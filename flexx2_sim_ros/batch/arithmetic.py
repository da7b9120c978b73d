"""
`camera.fastmath` and `camera.philox` once more, as functions of Warp's kernels.

The same polynomials and the same counters, so that what differs from the NumPy model is only how
a compiler contracts and orders float32 operations.
"""

from collections.abc import Sequence
import math
from typing import Any

from flexx2_sim_ros.physics import fastmath, philox
import numpy as np
import warp as wp


def _row(values: Sequence[np.float32]) -> Any:
    return wp.constant(wp.types.vector(len(values), wp.float32)(*map(float, values)))


_ARCCOS = _row(fastmath.ARCCOS)
_ARCTAN = _row(fastmath.ARCTAN)
_LOG2 = _row(fastmath.LOG2_TERMS)
_EXP2 = _row(fastmath.EXP2_TERMS)
_SIN = _row(fastmath.SIN_TERMS)
_COS = _row(fastmath.COS_TERMS)
_LN2 = wp.constant(wp.float32(math.log(2.0)))
_LOG2_E = wp.constant(wp.float32(1.0 / math.log(2.0)))
_SQRT2 = wp.constant(wp.float32(math.sqrt(2.0)))
_SQRT_HALF = wp.constant(wp.float32(math.sqrt(0.5)))
_PI = wp.constant(wp.float32(math.pi))
_HALF_PI = wp.constant(wp.float32(math.pi / 2))
_UNIT = wp.constant(wp.float32(2.0**-32))
_MULTIPLY_0 = wp.constant(wp.uint64(0xD2511F53))
_MULTIPLY_2 = wp.constant(wp.uint64(0xCD9E8D57))
_ADD_0 = wp.constant(wp.uint32(0x9E3779B9))
_ADD_1 = wp.constant(wp.uint32(0xBB67AE85))
_WORD = wp.constant(wp.uint64(32))


@wp.func
def arccos(c: wp.float32) -> wp.float32:
    """Return the arc cosine of a number in 0..1, radians."""
    a = _ARCCOS
    series = a[0] + c * (
        a[1] + c * (a[2] + c * (a[3] + c * (a[4] + c * (a[5] + c * (a[6] + c * a[7])))))
    )
    return wp.sqrt(wp.max(1.0 - c, 0.0)) * series


@wp.func
def log2(x: wp.float32) -> wp.float32:
    """Return the binary logarithm of a positive normal number."""
    bits = wp.cast(x, wp.int32)
    exponent = (bits >> 23) - 127
    mantissa = wp.cast((bits & 0x7FFFFF) | 0x3F800000, wp.float32)
    large = mantissa > _SQRT2
    mantissa = wp.where(large, mantissa * 0.5, mantissa)
    exponent = wp.where(large, exponent + 1, exponent)
    s = (mantissa - 1.0) / (mantissa + 1.0)
    t = s * s
    c = _LOG2
    return wp.float32(exponent) + s * (c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4]))))


@wp.func
def exp2(y: wp.float32) -> wp.float32:
    """Return 2 to a power, held in -126..127."""
    held = wp.min(wp.max(y, -126.0), 127.0)
    whole = wp.floor(held + 0.5)
    f = held - whole
    e = _EXP2
    series = e[0] + f * (
        e[1] + f * (e[2] + f * (e[3] + f * (e[4] + f * (e[5] + f * (e[6] + f * e[7])))))
    )
    return series * wp.cast((wp.int32(whole) + 127) << 23, wp.float32)


@wp.func
def power(x: wp.float32, exponent: wp.float32) -> wp.float32:
    """Return a positive number to a power."""
    return exp2(exponent * log2(x))


@wp.func
def log(x: wp.float32) -> wp.float32:
    """Return the natural logarithm of a positive normal number."""
    return _LN2 * log2(x)


@wp.func
def exp(x: wp.float32) -> wp.float32:
    """Return e to a power."""
    return exp2(_LOG2_E * x)


@wp.func
def cos_sin_turns(turns: wp.float32) -> wp.vec2f:
    """Return cosine and sine of an angle given in turns, 0..1."""
    quarters = turns * 4.0
    nearest = wp.floor(quarters + 0.5)
    f = quarters - nearest
    t = f * f
    s = _SIN
    c = _COS
    sine = f * (s[0] + t * (s[1] + t * (s[2] + t * (s[3] + t * s[4]))))
    cosine = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
    quadrant = wp.int32(nearest) & 3
    odd = (quadrant & 1) != 0
    first = wp.where(odd, sine, cosine)
    second = wp.where(odd, cosine, sine)
    # The cosine is negative in quadrants 1 and 2, the sine in 2 and 3.
    first = wp.where(((quadrant + 1) & 2) != 0, -first, first)
    second = wp.where((quadrant & 2) != 0, -second, second)
    return wp.vec2f(first, second)


@wp.func
def arctan2(y: wp.float32, x: wp.float32) -> wp.float32:
    """Return the angle of (x, y), radians in -pi..pi; 0 for (0, 0)."""
    large = wp.max(wp.abs(x), wp.abs(y))
    small = wp.min(wp.abs(x), wp.abs(y))
    t = wp.where(large > 0.0, small / large, 0.0)
    u = t * t
    a = _ARCTAN
    angle = t * (
        1.0
        + u
        * (
            a[0]
            + u
            * (a[1] + u * (a[2] + u * (a[3] + u * (a[4] + u * (a[5] + u * (a[6] + u * a[7]))))))
        )
    )
    angle = wp.where(wp.abs(y) > wp.abs(x), _HALF_PI - angle, angle)
    angle = wp.where(x < 0.0, _PI - angle, angle)
    return wp.where(y < 0.0, -angle, angle)


@wp.func
def philox4x32(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4ui:
    """Return four uint32 for a counter of four and a key of two uint32."""
    c0 = counter[0]
    c1 = counter[1]
    c2 = counter[2]
    c3 = counter[3]
    k0 = key[0]
    k1 = key[1]
    for _ in range(10):
        low = _MULTIPLY_0 * wp.uint64(c0)
        high = _MULTIPLY_2 * wp.uint64(c2)
        c0 = wp.uint32(high >> _WORD) ^ c1 ^ k0
        c1 = wp.uint32(high)
        c2 = wp.uint32(low >> _WORD) ^ c3 ^ k1
        c3 = wp.uint32(low)
        k0 = k0 + _ADD_0
        k1 = k1 + _ADD_1
    return wp.vec4ui(c0, c1, c2, c3)


@wp.func
def counter_of(index: wp.int32, stream: wp.uint32, stamp: wp.int64) -> wp.vec4ui:
    """Return the counter of block ``index`` of a stream at a stamp."""
    return wp.vec4ui(wp.uint32(index), stream, wp.uint32(stamp), wp.uint32(stamp >> wp.int64(32)))


@wp.func
def uniform(u: wp.uint32) -> wp.float32:
    """Return a number in (0, 1]."""
    return (wp.float32(u) + 0.5) * _UNIT


@wp.func
def normal_pair(u0: wp.uint32, u1: wp.uint32) -> wp.vec2f:
    """Return two independent standard normals (Box-Muller)."""
    radius = wp.sqrt(-2.0 * log(uniform(u0)))
    return radius * cos_sin_turns(wp.float32(u1) * _UNIT)


@wp.func
def four_normals(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4f:
    """Return the four standard normals of one counter."""
    u = philox4x32(counter, key)
    a = normal_pair(u[0], u[1])
    b = normal_pair(u[2], u[3])
    return wp.vec4f(a[0], a[1], b[0], b[1])


@wp.func
def one_of(values: wp.vec4f, which: wp.int32) -> wp.float32:
    """Return an element; a plain index would put the vector into memory on CUDA."""
    return wp.where(
        which < 2,
        wp.where(which == 0, values[0], values[1]),
        wp.where(which == 2, values[2], values[3]),
    )


@wp.func
def edge_draw(counter: wp.vec4ui, key: wp.vec2ui, laplace: wp.float32) -> wp.float32:
    """Return a draw of unit variance: normal, or with probability ``laplace`` Laplacian."""
    u = philox4x32(counter, key)
    pair = normal_pair(u[0], u[1])
    draw = pair[0]
    if wp.float32(u[2]) * _UNIT < laplace:
        half = (wp.float32(u[3] >> wp.uint32(1)) + 0.5) * (_UNIT + _UNIT)
        draw = -log(half) * _SQRT_HALF
        if (u[3] & wp.uint32(1)) == wp.uint32(0):
            draw = -draw
    return draw


# What the numbers are for, as in `camera.philox`.
AXIAL = wp.constant(wp.uint32(philox.STREAM_AXIAL))
ROW_EDGES = wp.constant(wp.uint32(philox.STREAM_ROW_EDGES))
COLUMN_EDGES = wp.constant(wp.uint32(philox.STREAM_COLUMN_EDGES))

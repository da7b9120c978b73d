"""
Elementary functions and phases in float32, made of nothing but arithmetic.

A compiler turns loops over them into vector instructions, which it cannot do with calls into the
C library, and another device repeats them to the last bits. Errors are a few float32 roundings.

Sources: Abramowitz and Stegun 4.4.46 (arc cosine) and 4.4.49 (arc tangent); the others
are Taylor series after range reduction.
"""

import math

from flexx2_sim_ros.formulas.scalars import (
    bits_of,
    f32,
    float_of,
    floor,
    i32,
    least,
    most,
    root,
    size,
    where,
)

_ZERO = f32(0.0)
_ONE = f32(1.0)
_HALF = f32(0.5)
_FOUR = f32(4.0)
_LOWEST = f32(-126.0)
_HIGHEST = f32(127.0)
_LN2 = f32(math.log(2.0))
_LOG2_E = f32(1.0 / math.log(2.0))
_SQRT2 = f32(math.sqrt(2.0))
_PI = f32(math.pi)
_HALF_PI = f32(math.pi / 2)
_LOG2 = tuple(f32(2.0 / math.log(2.0) / k) for k in (1, 3, 5, 7, 9))
_EXP2 = tuple(f32(math.log(2.0) ** k / math.factorial(k)) for k in range(8))
_SIN = tuple(
    f32((-1) ** k * (math.pi / 2) ** (2 * k + 1) / math.factorial(2 * k + 1)) for k in range(5)
)
_COS = tuple(f32((-1) ** k * (math.pi / 2) ** (2 * k) / math.factorial(2 * k)) for k in range(6))
_LEAST = f32(1e-37)  # close to the smallest normal number
_ARCCOS = tuple(
    f32(value)
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
_ARCTAN = tuple(
    f32(value)
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


def arccos(c: float) -> float:
    """Return the arc cosine of a number in 0..1, radians."""
    a = _ARCCOS
    series = a[0] + c * (
        a[1] + c * (a[2] + c * (a[3] + c * (a[4] + c * (a[5] + c * (a[6] + c * a[7])))))
    )
    return root(most(_ONE - c, _ZERO)) * series


def log2(x: float) -> float:
    """Return the binary logarithm of a positive normal number."""
    bits = bits_of(x)
    exponent = (bits >> 23) - 127
    mantissa = float_of((bits & 0x7FFFFF) | 0x3F800000)
    large = mantissa > _SQRT2
    mantissa = where(large, mantissa * _HALF, mantissa)
    exponent = where(large, exponent + 1, exponent)
    s = (mantissa - _ONE) / (mantissa + _ONE)
    t = s * s
    c = _LOG2
    return f32(exponent) + s * (c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4]))))


def exp2(y: float) -> float:
    """Return 2 to a power, held in -126..127."""
    held = least(most(y, _LOWEST), _HIGHEST)
    whole = floor(held + _HALF)
    f = held - whole
    e = _EXP2
    series = e[0] + f * (
        e[1] + f * (e[2] + f * (e[3] + f * (e[4] + f * (e[5] + f * (e[6] + f * e[7])))))
    )
    return series * float_of((i32(whole) + 127) << 23)


def power(x: float, exponent: float) -> float:
    """Return a positive number to a power."""
    return exp2(exponent * log2(x))


def log(x: float) -> float:
    """Return the natural logarithm of a positive normal number."""
    return _LN2 * log2(x)


def log_from_zero(x: float) -> float:
    """Return the natural logarithm of a number from 0 on; below 1e-37 that of 1e-37."""
    return log(most(x, _LEAST))


def exp(x: float) -> float:
    """Return e to a power."""
    return exp2(_LOG2_E * x)


def cos_sin_turns(turns: float) -> tuple[float, float]:
    """Return cosine and sine of an angle given in turns, 0..1."""
    quarters = turns * _FOUR
    closest = floor(quarters + _HALF)
    f = quarters - closest
    t = f * f
    s = _SIN
    c = _COS
    sine = f * (s[0] + t * (s[1] + t * (s[2] + t * (s[3] + t * s[4]))))
    cosine = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
    quadrant = i32(closest) & 3
    odd = (quadrant & 1) != 0
    first = where(odd, sine, cosine)
    second = where(odd, cosine, sine)
    # The cosine is negative in quadrants 1 and 2, the sine in 2 and 3.
    first = where(((quadrant + 1) & 2) != 0, -first, first)
    second = where((quadrant & 2) != 0, -second, second)
    return first, second


def arctan2(y: float, x: float) -> float:
    """Return the angle of (x, y), radians in -pi..pi; 0 for (0, 0)."""
    large = most(size(x), size(y))
    small = least(size(x), size(y))
    t = where(large > _ZERO, small / large, _ZERO)
    u = t * t
    a = _ARCTAN
    angle = t * (
        _ONE
        + u
        * (
            a[0]
            + u
            * (a[1] + u * (a[2] + u * (a[3] + u * (a[4] + u * (a[5] + u * (a[6] + u * a[7]))))))
        )
    )
    angle = where(size(y) > size(x), _HALF_PI - angle, angle)
    angle = where(x < _ZERO, _PI - angle, angle)
    return where(y < _ZERO, -angle, angle)


def direction(turns: float) -> tuple[float, float]:
    """Return cosine and sine of any number of turns."""
    return cos_sin_turns(turns - floor(turns))


def shift_between(
    real: float, imaginary: float, first_real: float, first_imaginary: float, wave_number: float
) -> float:
    """
    Return the distance, metres, by which the phase of light is ahead of that of the first light.

    Both are complex numbers; 0 is returned if one of them is 0. ``wave_number`` is in radians of
    phase a metre.
    """
    ahead = arctan2(
        imaginary * first_real - real * first_imaginary,
        real * first_real + imaginary * first_imaginary,
    )
    return ahead / wave_number

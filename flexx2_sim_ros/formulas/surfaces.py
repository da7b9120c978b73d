"""
Surfaces of inverse depth: where they break off, how they are inclined, and their noise.

A plane's inverse depth is an affine function of the pixel coordinates, so differences of it are
exact on planes at any slant, and a jump is what the slopes on either side do not explain.
"""

import math

from flexx2_sim_ros.formulas.fastmath import arccos, power
from flexx2_sim_ros.formulas.scalars import both, f32, least, most, root, size, where

# Slopes on the two sides of a pixel that differ by more than this fraction of p belong to a
# crease: the smoother side is used. Below it the mean of the two sides is used, which halves the
# error of depth stored in millimetres.
_CREASE_SHARE = f32(0.002)
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)
_HALF_PI = f32(math.pi / 2)
# Surfaces darker than this fraction of the white board have the noise of this one.
_DARKEST = f32(1e-3)
_TINY = f32(1e-30)


def is_jump(
    before: float, here: float, there: float, after: float, jump_share: float, steep_share: float
) -> bool:
    """
    Say whether a depth jump lies between two neighbours ``here`` and ``there``.

    All four are inverse depths in a line, 0 for nothing. The difference between the neighbours
    is a jump by as much as it lies outside the range of the slopes on either side: nothing on a
    plane, nothing at a crease, the step's height at an edge.
    """
    step = there - here
    slope_before = here - before
    slope_after = after - there
    slope_before = where(before > _ZERO, slope_before, where(after > _ZERO, slope_after, _ZERO))
    slope_after = where(after > _ZERO, slope_after, slope_before)
    low = least(slope_before, slope_after)
    high = most(slope_before, slope_after)
    excess = most(low - step, step - high)
    scale = least(here, there)
    # A small step is none, whatever lies beside it: the inside of a thin strip between jumps.
    differs = where(
        least(excess, size(step)) > jump_share * scale, True, size(step) > steep_share * scale
    )
    return where((here > _ZERO) != (there > _ZERO), True, where(here > _ZERO, differs, False))


def slope_between(
    p2: float, p1: float, p0: float, n1: float, n2: float, jump_before: bool, jump_after: bool
) -> float:
    """
    Return the slope of inverse depth at the middle of five pixels in a line.

    Never across a jump: there the other side is taken, and none at all between two jumps. At a
    crease the side that goes on more evenly is taken.
    """
    before = p0 - p1
    after = n1 - p0
    bend_before = where(p2 > _ZERO, size(before - (p1 - p2)), size(before))
    bend_after = where(n2 > _ZERO, size(after - (n2 - n1)), size(after))
    smoother = where(bend_before < bend_after, before, after)
    even = size(before - after) <= _CREASE_SHARE * p0
    both = where(even, _HALF * (before + after), smoother)
    one = where(jump_before, _ZERO, before) + where(jump_after, _ZERO, after)
    return where(jump_before, one, where(jump_after, one, both))


def plane_normal(
    here: float, du: float, dv: float, u: float, v: float, fx: float, fy: float
) -> tuple[float, float, float]:
    """
    Return the normal n, 1/m, of the plane n . X = 1 that a pixel sees.

    ``here`` is inverse depth, 1/m, ``du`` and ``dv`` its slopes along the row and the column, 1/m
    a pixel; ``u`` and ``v`` are from the principal point to the pixel, ``fx`` and ``fy`` focal
    lengths, pixels.
    """
    return fx * du, fy * dv, here - u * du - v * dv


def ray_length(rx: float, ry: float) -> float:
    """Return the range of a point on the ray (rx, ry, 1) over its depth."""
    return root(rx * rx + ry * ry + _ONE)


def cos_incidence(
    here: float,
    du: float,
    dv: float,
    u: float,
    v: float,
    rx: float,
    ry: float,
    fx: float,
    fy: float,
) -> float:
    """
    Return the cosine of the angle between a pixel's ray and its surface's normal.

    It is 1 where ``here``, the inverse depth, is 0. ``rx`` and ``ry`` are ``u`` and ``v`` over the
    focal lengths: the pixel's ray is (rx, ry, 1). The rest is as for `plane_normal`.
    """
    nx, ny, nz = plane_normal(here, du, dv, u, v, fx, fy)
    # n . ray = p for the pixel's ray.
    norm = (nx * nx + ny * ny + nz * nz) * (rx * rx + ry * ry + _ONE)
    return where(here > _ZERO, least(here / root(norm), _ONE), _ONE)


def beside(here: float, du: float, dv: float, across: float, down: float) -> float:
    """
    Return the inverse depth of a surface a fraction of a pixel beside a pixel's middle.

    ``here``, ``du`` and ``dv`` are as for `plane_normal`; ``across`` and ``down`` are how far
    beside, pixels.
    """
    value = here + across * du + down * dv
    return where(value > _ZERO, value, here)


def model_sigma(
    z: float, cosine: float, a: float, b: float, c: float, d: float, n: float, cap: float
) -> float:
    """
    Return the model's sigma_z of a surface, metres; a fit may be negative somewhere.

    ``z`` is depth, metres, ``cosine`` that of the incidence angle, which is at most ``cap``,
    radians. The rest are the mode's coefficients.
    """
    theta = least(arccos(cosine), cap)
    slant = theta / (_HALF_PI - theta)
    return a + z * (b + z * c) + d * power(z, n) * slant * slant


def sigma_of_surface(
    inverse: float, cosine: float, a: float, b: float, c: float, d: float, n: float, cap: float
) -> float:
    """Return `model_sigma` of an inverse depth; 0 without a return and where a fit is negative."""
    sigma = model_sigma(distance(inverse, _ONE), cosine, a, b, c, d, n, cap)
    return where(inverse > _ZERO, most(sigma, _ZERO), _ZERO)


def inverse_depth(z: float, nearest: float, farthest: float) -> float:
    """Return the inverse of a depth, 1/m; 0, for no return, of a depth outside the limits."""
    return where(both(nearest <= z, z <= farthest), _ONE / z, _ZERO)


def distance(inverse: float, otherwise: float) -> float:
    """Return the depth of an inverse depth, metres; ``otherwise`` without a return."""
    return where(inverse > _ZERO, _ONE / inverse, otherwise)


def returned_light(reflectivity: float, cosine: float, inverse: float) -> float:
    """Return the amplitude of the light that comes back from a surface, 1/m^2."""
    return reflectivity * cosine * inverse * inverse


def usable_reflectivity(given: float) -> float:
    """Return a reflectivity within 0..1; NaN is no light."""
    return where(given > _ZERO, least(given, _ONE), _ZERO)


def surface_factor(
    reflectivity: float,
    cosine: float,
    inverse: float,
    white: float,
    constant_share: float,
    read_share: float,
) -> float:
    """
    Return by what a surface's sigma_z differs from that of the white board in its place.

    The raw frames' noise is read noise, which is the same for all surfaces, and shot noise, whose
    variance grows with the light A (EMVA Standard 1288, the linear camera model; Falie and
    Buzuloiu, "Noise characteristics of 3D time-of-flight cameras", arXiv 0705.2673). The phase's
    error is that noise over A (Lange, "3D time-of-flight distance measurement with custom
    solid-state image sensors in CMOS/CCD-technology", Siegen 2000), so the variance of depth goes
    as (R + S A) / A^2. A part of the variance may not depend on light at all.

    Parameters
    ----------
    reflectivity : float
        Of the surface, 0..1.
    cosine, inverse : float
        Cosine of the incidence angle; inverse depth, 1/m.
    white : float
        Reflectivity of the board on which the model's coefficients were measured.
    constant_share : float
        Fraction of the board's variance that does not depend on light; 1: the factor is 1.
    read_share : float
        R / (R + S): fraction of read noise in the rest of the variance at an amplitude of 1/m^2.

    """
    ratio = white / most(usable_reflectivity(reflectivity), _DARKEST * white)
    shot = (_ONE - read_share) * returned_light(white, cosine, inverse)
    light = ratio * (shot + ratio * read_share) / most(shot + read_share, _TINY)
    return root(constant_share + (_ONE - constant_share) * light)

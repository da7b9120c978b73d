"""What a pixel reports of a surface: depth with noise, where it is valid, and its confidence."""

import math

from flexx2_sim_ros.formulas.scalars import both, f32, most, where

_ZERO = f32(0.0)
_ONE = f32(1.0)
_NAN = f32(math.nan)


def is_within(value: float, low: float, high: float) -> bool:
    """Say whether a depth lies within a range, its ends included; never true of NaN."""
    return both(low <= value, value <= high)


def kept_within(value: float, low: float, high: float) -> float:
    """Return a depth, NaN outside a range."""
    return where(is_within(value, low, high), value, _NAN)


def is_seen(z: float, value: float, low: float, high: float) -> bool:
    """Say whether a pixel is valid: its clean and its measured depth lie within the range."""
    return both(is_within(z, low, high), is_within(value, low, high))


def measured(z: float, sigma: float, normal: float, low: float, high: float) -> float:
    """Return a depth with axial noise, NaN where the depth without noise is outside a range."""
    return where(is_within(z, low, high), z + sigma * normal, _NAN)


def confidence(sigma: float, zero_at: float) -> float:
    """Return the confidence, 0..1, that falls with sigma_z and is 0 from ``zero_at`` on."""
    return most(_ONE - sigma / zero_at, _ZERO)

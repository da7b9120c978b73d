"""
What a pixel reports of a surface: depth with noise, where it is valid, and its confidence.

Edges move by whole pixels: which way, how far, and what pixels see then.
"""

import math

from flexx2_sim_ros.formulas.scalars import both, f32, i32, least, most, nearest, where

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


def is_upright(across: int, down: int) -> bool:
    """
    Say whether an edge runs nearer to vertical, or diagonally.

    It takes the number of depth jumps along rows and along columns in the window around it.
    """
    # One more or less is where the window happens to cut a diagonal.
    return across + 1 >= down


def pixels_moved(draw: float, sigma: float, limit: int) -> int:
    """
    Return by how many pixels an edge moves, at most `limit`.

    ``draw`` is a random number of unit variance, ``sigma`` the standard deviation before rounding,
    pixels.
    """
    return i32(nearest(least(most(sigma * draw, -f32(limit)), f32(limit))))


def is_apart(position: int, last_edge: int, neighbourhood: int) -> bool:
    """Say whether an edge moves on its own: more than ``neighbourhood`` pixels from the last."""
    return position - last_edge > neighbourhood


def passed_pixel(along: int, step: int, shift: int) -> int:
    """
    Return the position of a pixel that an edge passes when it moves.

    The edge is between the positions ``along`` and ``along + 1`` of a line. ``step`` is 1 for the
    first pixel that it passes; ``shift`` is by how many pixels it moves, below 0 towards position
    0.
    """
    return where(shift > 0, along + step, along + 1 - step)


def source_of(position: int, shift: int, last: int) -> int:
    """Return the position on a line, 0..last, that a pixel takes its value from."""
    return least(most(position - shift, i32(0)), last)

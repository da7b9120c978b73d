"""Edges that move through a pixel shortly before or after a frame, found in two frames."""

from flexx2_sim_ros.effects.between import alike
from flexx2_sim_ros.formulas.scalars import at, ceiling, f32, i32, least, most, size, where
import numpy as np
from numpy.typing import NDArray

# Pixels show different surfaces if their depth differs by more than the first, and different
# colours if their reflectivity does by more than the second, both as fractions (assumed).
_JUMP = f32(0.05)
_COLOUR = f32(0.25)
_WIDEST = i32(24)  # pixels that an edge moves between two frames at most (30 Hz: 3 rad/s)
_NEVER = f32(1.0)
_ZERO = f32(0.0)
_ONE = f32(1.0)


def own_change(
    early: float, late: float, early_rho: float, late_rho: float, seconds: float
) -> tuple[float, float]:
    """
    Return how what a pixel sees has changed since the frame before, `seconds` ago.

    Depths (``early``, ``late``) are in metres, reflectivities above 0. The first result is the
    depth before less the depth now, metres; 0 where another surface was there. The second is the
    light before over that now; a colour that is clearly another one does not count.
    """
    start = early - late
    same = alike(start, late, seconds)
    smooth = size(early_rho - late_rho) <= _COLOUR * least(early_rho, late_rho)
    # Nearer is brighter.
    further = late / early
    gain = where(smooth, early_rho / late_rho, _ONE) * further * further
    return where(same, start, _ZERO), where(same, gain, _ONE)


def is_edge(first: float, second: float, first_rho: float, second_rho: float) -> bool:
    """Say whether two neighbours show different surfaces or colours."""
    jump = size(first - second) > _JUMP * least(first, second)
    return jump or size(first_rho - second_rho) > _COLOUR * least(first_rho, second_rho)


def is_level(first: float, second: float) -> bool:
    """Say whether the depths of two neighbours are alike."""
    return size(first - second) <= _JUMP * least(first, second)


def resembles(depth: float, rho: float, other: float, other_rho: float, by_colour: bool) -> bool:
    """Say whether two pixels may show the same surface and, if it counts, the same colour."""
    near = size(depth - other) <= _JUMP * other
    return near and (not by_colour or size(rho - other_rho) <= _COLOUR * other_rho)


def edge_reach(earliest: float, latest: float) -> int:
    """Return how many pixels away edges can be that pass in time; see `find_passing`."""
    return i32(ceiling(most(earliest, latest) * f32(_WIDEST)))


def edge_speed(
    early: NDArray[np.float32],
    late: NDArray[np.float32],
    early_rho: NDArray[np.float32],
    late_rho: NDArray[np.float32],
    early_i: int,
    late_i: int,
    step: int,
    behind: int,
    ahead: int,
) -> int:
    """
    Return how many pixels an edge has moved since the frame before, above 0 if ahead.

    Both of its sides are looked for nearest to it in the frame before; 0 where they are not found.
    The images, depth and reflectivity of both frames, are flat. ``early_i`` and ``late_i`` are the
    last pixel before the edge, ``step`` is from one pixel to the next across it; ``behind`` and
    ``ahead`` are how many pixels of the image are before that pixel and after it.
    """
    own = at(late, late_i)
    own_rho = at(late_rho, late_i)
    other = at(late, late_i + step)
    other_rho = at(late_rho, late_i + step)
    by_colour = is_level(own, other)
    speed = i32(0)
    n = i32(0)
    while n <= 2 * _WIDEST:
        # 0, 1, -1, 2, -2, ... pixels away.
        moved = where(n % 2 == 1, (n + 1) // 2, -(n // 2))
        if moved >= -behind and moved < ahead:
            j = early_i + moved * step
            if resembles(at(early, j), at(early_rho, j), own, own_rho, by_colour):
                j = early_i + (moved + 1) * step
                if resembles(at(early, j), at(early_rho, j), other, other_rho, by_colour):
                    speed = i32(-moved)
                    n = i32(2 * _WIDEST)
        n += 1
    return speed


def find_passing(
    early: NDArray[np.float32],
    late: NDArray[np.float32],
    early_rho: NDArray[np.float32],
    late_rho: NDArray[np.float32],
    right: int,
    left: int,
    down: int,
    up: int,
    early_i: int,
    late_i: int,
    y: int,
    x: int,
    height: int,
    width: int,
    earliest: float,
    latest: float,
    place: float,
) -> tuple[float, float, float]:
    """
    Return what a pixel sees on the other side of the edge that passes it next in time.

    Edges in its row and column keep the speed that they had since the frame before.

    Parameters
    ----------
    early, late, early_rho, late_rho : numpy.ndarray
        Flat images: depth and reflectivity in the frame before and in this one.
    right, left, down, up : int
        How many pixels away the next surface or colour is; 0: none counts.
    early_i, late_i : int
        The pixel, in both.
    y, x, height, width : int
        Where it is in the image.
    earliest, latest : float
        How long before and after this frame an edge counts; 1 is the time between the frames.
    place : float
        Where in a pixel edges are, 0..1.

    Returns
    -------
    depth : float
        Metres.
    light : float
        Over that of what the pixel sees in this frame.
    when : float
        When the edge passes: 0 at the frame before, 1 at this one, where none does, above 1 after.

    """
    depth = at(late, late_i)
    rho = at(late_rho, late_i)
    other = f32(depth)
    light = f32(1.0)
    when = f32(_NEVER)
    soonest = most(earliest, latest)
    for side in range(4):
        step = where(side < 2, i32(1), width)
        behind = where(side < 2, x, y)
        ahead = where(side < 2, width - 1 - x, height - 1 - y)
        if side % 2 == 1:
            step = -step
            behind, ahead = ahead, behind
        k = where(side < 2, where(side == 0, right, left), where(side == 2, down, up))
        if k > 0:
            speed = edge_speed(
                early,
                late,
                early_rho,
                late_rho,
                early_i + (k - 1) * step,
                late_i + (k - 1) * step,
                step,
                behind + k - 1,
                ahead - k + 1,
            )
            if speed != 0:
                ago = (f32(k) - place) / f32(speed)
                if ago <= earliest and ago >= -latest and size(ago) < soonest:
                    soonest = size(ago)
                    when = _ONE - ago
                    other = at(late, late_i + k * step)
                    closer = depth / other
                    light = at(late_rho, late_i + k * step) / rho * closer * closer
    return other, light, when

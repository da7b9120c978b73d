"""What is seen between two frames."""

from typing import Any

from flexx2_sim_ros.formulas.scalars import f32, f64, i32, most, size, where
import numpy as np
from numpy.typing import NDArray

# Two frames show the same surface if its distance changes by less than the first (as a fraction of
# the distance), or more slowly than the second, m/s (assumed; twice a trotting Go1).
_ALIKE_SHARE = f32(0.05)
_ALIKE_SPEED = f32(3.0)
_HALF = f64(0.5)


def frames_around(
    stamps: NDArray[np.int64], first: int, slots: int, oldest: int, count: int, moment: np.int64
) -> tuple[int, int]:
    """
    Return which of a camera's kept frames are before and after a moment, as slots.

    Before the oldest frame both are the oldest one. After the newest they are the last two.
    ``stamps`` of each slot and ``moment`` are nanoseconds. The camera has the slots ``first`` to
    ``first + slots - 1``, used in turn. ``oldest`` is the slot of its oldest frame, 0..slots - 1,
    and ``count`` how many frames it has, 1 or more.
    """
    early = i32(oldest)
    late = i32(oldest)
    if moment > stamps[first + oldest]:
        i = i32(1)
        while i < count and (i == 1 or stamps[first + late] < moment):
            early = late
            late = (late + 1) % slots
            i += 1
    return early, late


def share_of(elapsed: np.int64, interval: np.int64) -> np.float64:
    """Return where a moment is between two frames: 0 at the earlier one, 1 at the later one."""
    return f64(elapsed) / f64(interval)


def is_late_nearer(share: np.float64) -> bool:
    """Say whether a moment is nearer to the later of two frames; see `share_of`."""
    return share >= _HALF


def alike(change: float, late: float, seconds: float) -> bool:
    """
    Say whether a pixel sees the same surface in two frames, `seconds` apart.

    ``change`` of its depth, and ``late``, its depth in the later frame, are in metres.
    """
    return size(change) < most(_ALIKE_SHARE * late, _ALIKE_SPEED * seconds)


def seen_between(early: float, late: float, nearer: float, share: float, seconds: float) -> float:
    """Return what `between` does, for a pixel; ``nearer`` is the frame that is nearer in time."""
    change = late - early
    return where(alike(change, late, seconds), early + share * change, nearer)


def between(early: np.ndarray, late: np.ndarray, share: float, seconds: float) -> np.ndarray:
    """
    Return what is seen at a moment between two frames `seconds` apart, or a little after.

    A surface moves evenly; where another one has come into view, the frame that is nearer in time
    shows what there is. Frames are (H, W) float32 metres. ``share`` is 0 at the time of ``early``,
    1 at that of ``late``.
    """
    nearer = late if is_late_nearer(np.float64(share)) else early
    images: tuple[Any, ...] = early, late, nearer
    with np.errstate(invalid='ignore', over='ignore'):
        seen: Any = seen_between(*images, np.float32(share), np.float32(seconds))  # type: ignore
    return np.asarray(seen)

"""What is seen between two frames."""

from typing import Any

from flexx2_sim_ros.formulas.scalars import f32, most, size, where
import numpy as np

# Two frames show the same surface if its distance changes by less than the first (as a fraction of
# the distance), or more slowly than the second, m/s (assumed; twice a trotting Go1).
_ALIKE_SHARE = f32(0.05)
_ALIKE_SPEED = f32(3.0)


def alike(change: float, late: float, seconds: float) -> bool:
    """
    Say whether a pixel sees the same surface in two frames.

    Parameters
    ----------
    change : float
        By how much its depth changes, metres.
    late : float
        Its depth in the later frame, metres.
    seconds : float
        Between the frames.

    """
    return size(change) < most(_ALIKE_SHARE * late, _ALIKE_SPEED * seconds)


def seen_between(early: float, late: float, nearer: float, share: float, seconds: float) -> float:
    """Return what `between` does, for a pixel; ``nearer`` is the frame that is nearer in time."""
    change = late - early
    return where(alike(change, late, seconds), early + share * change, nearer)


def between(early: np.ndarray, late: np.ndarray, share: float, seconds: float) -> np.ndarray:
    """
    Return what is seen at a moment between two frames, or a little after.

    A surface moves evenly; where another one has come into view, the frame that is nearer in time
    shows what there is.

    Parameters
    ----------
    early, late : numpy.ndarray
        (H, W) float32 metres.
    share : float
        0 at the time of ``early``, 1 at that of ``late``.
    seconds : float
        Between the two.

    """
    nearer = late if share >= 0.5 else early
    images: tuple[Any, ...] = early, late, nearer
    with np.errstate(invalid='ignore', over='ignore'):
        seen: Any = seen_between(*images, np.float32(share), np.float32(seconds))  # type: ignore
    return np.asarray(seen)

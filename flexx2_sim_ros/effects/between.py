"""What is seen between two frames."""

import numpy as np

# Two frames show the same surface if its distance changes by less than the first (as a fraction of
# the distance), or more slowly than the second, m/s (assumed; twice a trotting Go1).
ALIKE_SHARE = 0.05
ALIKE_SPEED = 3.0


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
    with np.errstate(invalid='ignore', over='ignore'):
        change = late - early
        same = np.abs(change) < np.maximum(
            np.float32(ALIKE_SHARE) * late, np.float32(ALIKE_SPEED * seconds)
        )
        nearer = late if share >= 0.5 else early
        return np.where(same, early + np.float32(share) * change, nearer)

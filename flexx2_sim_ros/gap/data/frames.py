"""Which frames of a recording the diagnosis reads."""

from flexx2_sim_ros.gap.calibration.data import READING
import numpy as np

MOST_FRAMES, _SEGMENT = READING.most_frames, READING.segment


def choose_frames(count: int, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Choose the frames of a recording that the diagnosis reads; more are read of small images.

    Return the indices of the chosen frames; and for each whether it starts a segment, so that it
    does not follow the chosen frame before it.
    """
    if count <= max(MOST_FRAMES, min(READING.most_small, READING.pixels // (height * width))):
        fresh = np.zeros(count, bool)
        fresh[:1] = True
        return np.arange(count), fresh
    starts = np.linspace(0, count - _SEGMENT, MOST_FRAMES // _SEGMENT).astype(int)
    chosen = np.unique(np.concatenate([np.arange(s, s + _SEGMENT) for s in starts]))
    fresh = np.ones(len(chosen), bool)
    fresh[1:] = np.diff(chosen) != 1
    return chosen, fresh

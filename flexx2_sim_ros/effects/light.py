"""The light of each pixel, as curves take it."""

import numpy as np


def log_amplitude(amplitude: np.ndarray) -> np.ndarray:
    """Return the natural logarithm of an amplitude in 1/m^2, float32; that of 1e-30 for none."""
    return np.log(np.maximum(amplitude, np.float32(1e-30)))

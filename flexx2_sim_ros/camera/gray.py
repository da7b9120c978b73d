"""The camera's gray image."""

import numpy as np


def gray_image(amplitude: np.ndarray, exposure: float | None, full_scale: float) -> np.ndarray:
    """
    Turn amplitude into an 8-bit picture.

    Parameters
    ----------
    amplitude : numpy.ndarray
        (H, W) float32, 1/m^2, 0 where invalid.
    exposure : float or None
        Exposure as a fraction of the mode's longest; None chooses it automatically, so that no
        more than one pixel in a hundred saturates.
    full_scale : float
        Amplitude of a white pixel at the longest exposure, 1/m^2; see `Sensor`.

    Returns
    -------
    numpy.ndarray
        (H, W) uint8, square root of the amplitude, 255 at full scale.

    """
    if exposure is None:
        bright = float(np.percentile(amplitude, 99))
        exposure = min(1.0, full_scale / bright) if bright > 0 else 1.0
    level = np.sqrt(amplitude * np.float32(exposure / full_scale))
    return (np.minimum(level, 1.0) * 255.0 + 0.5).astype(np.uint8)

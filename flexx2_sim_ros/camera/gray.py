"""The camera's gray image."""

from flexx2_sim_ros.profiles.modes import camera_config
import numpy as np


def gray_image(amplitude: np.ndarray, exposure: float | None) -> np.ndarray:
    """
    Turn amplitude into an 8-bit picture.

    Parameters
    ----------
    amplitude : numpy.ndarray
        (H, W) float32, 1/m^2, 0 where invalid.
    exposure : float or None
        Exposure as a share of the mode's longest; None chooses it automatically, so that no
        more than one pixel in a hundred saturates.

    Returns
    -------
    numpy.ndarray
        (H, W) uint8, square root of the amplitude, 255 at full scale.

    """
    full_scale = camera_config().full_scale_amplitude
    if exposure is None:
        bright = float(np.percentile(amplitude, 99))
        exposure = min(1.0, full_scale / bright) if bright > 0 else 1.0
    level = np.sqrt(amplitude * np.float32(exposure / full_scale))
    return (np.minimum(level, 1.0) * 255.0 + 0.5).astype(np.uint8)

"""What a camera puts out: frames, and the gray image of their amplitude."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """
    What the camera saw.

    The images of a stack share memory: keep a copy of one to let go of the others.

    Attributes
    ----------
    depth : numpy.ndarray
        (..., H, W) float32, metres along the optical axis, NaN where invalid.
    sigma : numpy.ndarray
        (..., H, W) float32, the model's sigma_z of what was seen, metres, NaN where invalid.
    amplitude : numpy.ndarray
        (..., H, W) float32, reflectivity * cos(incidence) / z^2, 1/m^2, 0 where invalid; but full
        scale or more where it is too much light (the effect ``saturation``) that makes it so.
    confidence : numpy.ndarray
        (..., H, W) float32 in 0..1, 0 where invalid.
    K : numpy.ndarray
        The camera matrix that was given, float64.

    """

    depth: np.ndarray
    sigma: np.ndarray
    amplitude: np.ndarray
    confidence: np.ndarray
    K: np.ndarray  # noqa: N815

    def make_invalid(self, where: np.ndarray) -> None:
        """Make pixels (H, W) bool invalid, in place."""
        if where.any():
            self.depth[..., where] = np.nan
            self.sigma[..., where] = np.nan
            self.amplitude[..., where] = 0.0
            self.confidence[..., where] = 0.0


def gray_image(amplitude: np.ndarray, exposure: float | None, full_scale: float) -> np.ndarray:
    """
    Turn amplitude, (H, W) float32, 1/m^2, 0 where invalid, into an 8-bit picture.

    It is (H, W) uint8, square root of the amplitude, 255 at full scale. ``exposure`` is a fraction
    of the mode's longest; None chooses it automatically, so that no more than one pixel in a
    hundred saturates. ``full_scale`` is the amplitude of a white pixel at the longest exposure,
    1/m^2; see `Sensor`.
    """
    if exposure is None:
        bright = float(np.percentile(amplitude, 99))
        exposure = min(1.0, full_scale / bright) if bright > 0 else 1.0
    level = np.sqrt(amplitude * np.float32(exposure / full_scale))
    return (np.minimum(level, 1.0) * 255.0 + 0.5).astype(np.uint8)

"""What a camera puts out."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """
    What the camera saw.

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

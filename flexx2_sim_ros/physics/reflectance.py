"""Reflectivity from the light that comes back: the inverse of reflectivity * cos / depth^2."""

import numpy as np

_LEAST_COSINE = 0.05  # the light of a steeper surface says nothing of its reflectivity


def falloff(depth: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """
    Return by what an amplitude is multiplied to get a reflectivity, up to scale, (..., H, W) m^2.

    ``depth`` is in metres along the optical axis, ``cosine`` that of the angle between ray and
    surface normal. NaN for nothing.
    """
    return np.asarray(depth**2 / np.maximum(cosine, _LEAST_COSINE))

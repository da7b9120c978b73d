"""The spread of errors with outliers."""

import numpy as np

# The standard deviation of normally distributed errors whose median absolute value is 1.
PER_MEDIAN = 1.4826


def robust_sigma(errors: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the standard deviation of errors about 0, by their median absolute value."""
    return np.asarray(PER_MEDIAN * np.nanmedian(np.abs(errors), axis=axis))

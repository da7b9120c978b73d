"""The spread of errors with outliers."""

import numpy as np

# The standard deviation of normally distributed errors whose median absolute value is 1.
PER_MEDIAN = 1.4826


def robust_sigma(errors: np.ndarray, axis: int | None = None) -> np.ndarray:
    """
    Return the standard deviation of errors by their median absolute value.

    Parameters
    ----------
    errors : numpy.ndarray
        Of any shape, about 0; NaN does not count, and not all may be NaN.
    axis : int, optional
        The axis to reduce (default: all).

    Returns
    -------
    numpy.ndarray
        The standard deviation, in the unit of the errors.

    """
    return np.asarray(PER_MEDIAN * np.nanmedian(np.abs(errors), axis=axis))

"""Kullback-Leibler divergence of measured noise from the model, in nats, and its floor."""

from typing import Any

import numpy as np
from scipy.special import digamma


def gaussian_kl(variance: Any, mean_square: Any, log_variance: Any, sigma: Any) -> np.ndarray:
    """
    Return the divergence of a measured Gaussian from the model's, which has mean 0.

    Parameters
    ----------
    variance : array_like
        What was measured; or its mean over pixels of one and the same `sigma`.
    mean_square : array_like
        The square of the measured mean; or its mean over pixels.
    log_variance : array_like
        Natural logarithm of the measured variance; or its mean over pixels.
    sigma : array_like
        The model's standard deviation.

    Returns
    -------
    numpy.ndarray
        Nats; over pixels, their mean. 0 where both are the same.

    """
    sigma2 = np.square(sigma)
    return 0.5 * (
        (np.asarray(variance) + mean_square) / sigma2 - 1.0 - log_variance + np.log(sigma2)
    )


def kl_floor(count: Any) -> np.ndarray:
    """
    Return what the divergence of one pixel is on average for a perfect model.

    `count` frames do not fix a mean and a variance better than this: about 1 / count. Taken off
    a measured divergence it leaves what is the model's.
    """
    count = np.asarray(count, np.float64)
    half = np.maximum(count - 1.0, 1.0) / 2.0
    return 0.5 * (1.0 / np.maximum(count, 1.0) + np.log(half) - digamma(half))


def mean_kl(samples: np.ndarray, clean: np.ndarray, sigma: np.ndarray) -> float:
    """
    Return the mean over pixels of the divergence of what was measured from the model, in nats.

    Each pixel's measured noise is the Gaussian with its mean and standard deviation over the
    frames.

    Parameters
    ----------
    samples : numpy.ndarray
        (T, ...) metres, all valid.
    clean, sigma : numpy.ndarray
        (...) what is really there, and the model's standard deviation, metres.

    """
    error = samples.astype(np.float64) - clean
    variance = error.var(axis=0, ddof=1)
    return float(np.mean(gaussian_kl(variance, error.mean(axis=0) ** 2, np.log(variance), sigma)))

"""How sure a comparison of fits is, judged by how it varies from recording to recording."""

import math

from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.inference.fitting import Fit
import numpy as np
from scipy import stats


def advantage(one: Fit, other: Fit) -> float:
    """
    Return how clearly one fit explains new recordings better than another one of the same.

    It is Student's t, as in a paired t-test: the mean difference of the losses of held-out
    recordings over its standard error. It is 0 for a single recording.
    """
    return t_of(improvements(one, other), THRESHOLDS.least_error)


def t_of(differences: np.ndarray, least: float = 1e-9) -> float:
    """
    Return Student's t of (R,) differences of recordings; 0 of a single one.

    `least` is added to their standard error.
    """
    if len(differences) < 2:
        return 0.0
    error = float(differences.std(ddof=1)) / math.sqrt(len(differences)) + least
    return float(differences.mean()) / error


def improvements(one: Fit, other: Fit) -> np.ndarray:
    """
    Return by how much the loss of each left-out recording is lower with fit `one`, (R,).

    Each has its part of the loss of the nuisances.
    """
    poses = (other.pose_held_out - one.pose_held_out) / len(one.held_out)
    return np.asarray(other.held_out - one.held_out + poses)


def ratio_interval(top: np.ndarray, bottom: np.ndarray) -> list[float] | None:
    """
    Return the 90 % interval of sum(top) / sum(bottom) in as many new recordings.

    `top` and `bottom` are (R,), one value a recording; None with fewer than three. The ratio is
    from `THRESHOLDS.least_shrink` to 1. The jackknife (Efron and Tibshirani, An Introduction to
    the Bootstrap, 1993, chapter 11) gives its standard error over sets of recordings; it counts
    twice, because both what is predicted and what is found in the new set vary.
    """
    count = len(top)
    whole = top.sum() / max(bottom.sum(), 1e-9)
    if count < 3:
        return None
    rest = (top.sum() - top) / np.maximum(bottom.sum() - bottom, 1e-9)
    error = np.sqrt((count - 1) / count * np.square(rest - rest.mean()).sum())
    reach = float(stats.t.ppf(THRESHOLDS.quantile, count - 1)) * math.sqrt(2) * float(error)
    least = THRESHOLDS.least_shrink
    return [float(np.clip(end, least, 1)) for end in (whole - reach, whole + reach)]


def mean_interval(values: np.ndarray) -> list[float] | None:
    """Return the 90 % interval of the mean of (R,) values, by Student's t; None for one value."""
    count = len(values)
    if count < 2:
        return None
    error = float(values.std(ddof=1)) / math.sqrt(count)
    reach = float(stats.t.ppf(THRESHOLDS.quantile, count - 1)) * error
    return [float(values.mean()) - reach, float(values.mean()) + reach]

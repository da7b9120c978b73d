"""How much the simulated effects improve each measure of the gap, and whether it matters."""

from typing import Any

from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.uncertainty import mean_interval, ratio_interval
import numpy as np


def tolerances(model: Model) -> dict[str, float]:
    """
    Return by how much each of `physical.UNITS` may change without mattering.

    These are the tolerances of the diagnosis' features: 0.1 sigma_z of bias (in millimetres with
    the mean sigma_z of the recordings, and as the divergence of two normal distributions), 0.8 %
    of invalid pixels, 0.1 of log variance, 0.04 of a correlation.
    """
    table = FEATURES.tolerances
    sigmas = np.array([one.sigma[AXES['all'].start] for one in model.evidence], float)
    sigmas = sigmas[np.isfinite(sigmas)]  # A recording without surfaces has none.
    return {
        'wasserstein_mm': 1000 * table['bias'] * float(sigmas.mean() if len(sigmas) else 0.0),
        'wasserstein_sigma': table['bias'],
        'edge_sigma': table['bias'],
        'invalid_rate': table['invalid'],
        'log_variance': table['log_variance'],
        'correlation': table['neighbour'],
        'lag': table['lag'],
        'kl_nats': table['bias'] ** 2 / 2,
    }


def measured(values: np.ndarray, tolerance: float) -> dict[str, Any]:
    """
    Summarise one measure of all recordings.

    Parameters
    ----------
    values : numpy.ndarray
        (R, 3) before, after, and of two simulations.
    tolerance : float
        A smaller change of the mean does not matter.

    Returns
    -------
    dict
        Means ``before``, ``after``, ``null`` and ``change`` (after less before), each with a 90 %
        interval over recordings (None with one recording); ``shrink``, the fraction of the gap
        that goes away, and its interval (None with fewer than three recordings); ``tolerance``;
        ``better`` and ``worse``: whether the change is significant and matters.

    """
    columns = {
        'before': values[:, 0],
        'after': values[:, 1],
        'null': values[:, 2],
        'change': values[:, 1] - values[:, 0],
    }
    out: dict[str, Any] = {}
    for name, column in columns.items():
        out[name] = float(column.mean())
        interval = mean_interval(column)
        if interval is not None and name != 'change':
            interval[0] = max(interval[0], 0.0)  # No measure is negative.
        out[f'{name}_interval'] = interval
    top, bottom = values[:, 0] - values[:, 1], values[:, 0] - values[:, 2]
    gap = bottom.sum() > 0
    out['shrink'] = (
        float(np.clip(top.sum() / bottom.sum(), THRESHOLDS.least_shrink, 1)) if gap else 0.0
    )
    out['shrink_interval'] = (
        ratio_interval(top, bottom, THRESHOLDS.least_shrink) if gap and len(values) > 2 else None
    )
    low, high = out['change_interval'] or [out['change']] * 2
    out['tolerance'] = tolerance
    out['better'] = bool(high < 0 and out['change'] < -tolerance)
    out['worse'] = bool(low > 0 and out['change'] > tolerance)
    return out

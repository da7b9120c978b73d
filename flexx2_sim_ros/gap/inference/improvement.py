"""How much the simulated effects improve each measure of the gap, and whether it matters."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.features.confirm import Apart, Outcome
from flexx2_sim_ros.gap.features.features import LAYOUT
from flexx2_sim_ros.gap.features.grain import repeats
from flexx2_sim_ros.gap.features.physical import TOLERANCES, UNITS
from flexx2_sim_ros.gap.inference.fitting import Fit, fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.uncertainty import mean_interval, ratio_interval
import numpy as np

_REPEAT = next(i for i, one in enumerate(LAYOUT) if one.channel == 'repeat')
_AT_EDGES = np.array(
    [one.axis in ('edge', 'concavity') or one.channel.startswith('jump_') for one in LAYOUT]
)
# Of a gap, as from `confirm.how_far`.
_PARTS = 'distance', 'mm', 'invalid_percent', 'noise'


def tolerances(model: Model) -> dict[str, float]:
    """
    Return by how much each of `physical.UNITS` may change without mattering.

    That of ``wasserstein_mm`` is that of ``wasserstein_sigma`` with the mean sigma_z of the
    recordings.
    """
    sigmas = np.array([one.sigma[AXES['all'].start] for one in model.evidence], float)
    sigmas = sigmas[np.isfinite(sigmas)]  # A recording without surfaces has none.
    mean = float(sigmas.mean() if len(sigmas) else 0.0)
    return {'wasserstein_mm': 1000 * TOLERANCES['wasserstein_sigma'] * mean, **TOLERANCES}


def all_measured(model: Model, apart: Sequence[Apart]) -> dict[str, Any]:
    """
    Summarise all measures of the gap, and the distance that is made of them.

    ``worse`` has the names of those that the effects make significantly worse; ``distance`` and
    each of `physical.UNITS` are as from `measured`.
    """
    limits = tolerances(model)
    units = {
        unit: measured(np.array([one.physical[unit] for one in apart]), limits[unit])
        for unit in UNITS
    }
    far = np.array([[one.far(k)[0] for k in range(3)] for one in apart])
    worse = [unit for unit in UNITS if units[unit]['worse']]
    return {'worse': worse, 'distance': measured(far, 1.0), **units}


def simulated_losses(
    without: tuple[Model, Fit],
    fitted: tuple[Model, Fit],
    confirmed: Sequence[Outcome],
    motions: Sequence[np.ndarray],
    edges: bool,
    common_pose: bool = False,
) -> np.ndarray:
    """
    Return losses without effects, with effects simulated, and of noise alone, (R, 3).

    The fit of effects adds up their features and interpolates between strengths. Here the effects
    are simulated as they are. Each recording has its part of the loss of poses and other
    nuisances, which are fitted again.

    * `without`, `fitted`: the recordings and their fit, without and with the effects.
    * `confirmed`: each recording, simulated with the effects.
    * `motions`: (6 + 3 P,) where its camera and its planes are then, as for `registration.place`.
    * `edges`: whether features at jumps and sharp bends count; see `counts_edges`.
    * `common_pose`: whether a pose error is among the effects: what the poses have in common is no
      loss.
    """
    used = ~_AT_EDGES | edges
    model, accepted = fitted
    gap = np.array([one.seen[0] - one.seen[2] for one in confirmed])
    alike = [repeats([one.grain for one in some]) for some in (model.evidence, confirmed)]
    gap[:, _REPEAT] = alike[0] - alike[1]
    left = model.with_gap(np.where(np.isfinite(gap), gap, accepted.residual(model)))
    left.own = model.own.at(motions)
    if common_pose:
        left.own.centre = left.own.pose[left.own.posed].mean(axis=0)
    after = fit(left, [])
    noise = np.where(model.good, np.nan_to_num([one.noise for one in confirmed]), 0)
    rests = [one.residual(of) for of, one in (without, (left, after))]
    losses = [model.losses(np.where(used, one, 0)) for one in (*rests, noise)]
    own = without[1].pose_loss, after.pose_loss, after.pose_loss
    return np.stack(losses, axis=1) + np.array(own) / len(gap)


def measured(values: np.ndarray, tolerance: float) -> dict[str, Any]:
    """
    Summarise one measure of all recordings: (R, 3) before, after, and of two simulations.

    A change of the mean below `tolerance` does not matter.

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
    out['shrink_interval'] = ratio_interval(top, bottom) if gap else None
    low, high = out['change_interval'] or [out['change']] * 2
    out['tolerance'] = tolerance
    out['better'] = bool(high < 0 and out['change'] < -tolerance)
    out['worse'] = bool(low > 0 and out['change'] > tolerance)
    return out


def taken_off(part: np.ndarray) -> dict[str, Any]:
    """Return a part of the gap, (R, 4): means over recordings, each with a 90 % interval."""
    return {
        name: {'mean': float(column.mean()), 'interval': mean_interval(column)}
        for name, column in zip(_PARTS, part.T, strict=True)
    }


def remaining(elsewhere: Sequence[Apart], fitted: Sequence[Apart]) -> dict[str, Any]:
    """
    Return the parts of the gap `elsewhere` that no effect takes off, each as from `taken_off`.

    With those of the effects, and with what two simulations differ by, they add up to what a
    recording and its simulation differ by.

    * `absorbed_by_poses`: what the `fitted` poses take off.
    * `not_explained`: what is left, less what two simulations differ by.
    """
    pairs = list(zip(elsewhere, fitted, strict=True))
    absorbed = np.array([there.far(0) - here.far(0) for there, here in pairs])
    left = np.array([here.far(1) - there.far(2) for there, here in pairs])
    return {'absorbed_by_poses': taken_off(absorbed), 'not_explained': taken_off(left)}

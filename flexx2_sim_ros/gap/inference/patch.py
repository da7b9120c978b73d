"""Fit a correction without a cause to what is left when no effect explains the gap."""

from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.effects.patch import COVARIATES, ResidualPatch
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.features.features import LAYOUT
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.where import mean_sigma
import numpy as np

_CHANNELS = ('bias', 'log_variance', 'invalid')


@dataclass(frozen=True)
class Patch:
    """
    A correction without a cause, as fitted to all recordings: its bins are over `covariate`.

    `shrink` is the fraction by which its table reduces the gap in bias, noise and invalid pixels
    over all three covariates; computed, not simulated. There each of several recordings takes the
    correction that was fitted without it, which is in `without`. A single recording cannot be left
    out.
    """

    effect: Effect
    covariate: str
    shrink: float
    without: list[Effect]


def fit_patch(model: Model, residual: np.ndarray) -> Patch:
    """
    Fit the patch over the one covariate with which it reduces the gap most.

    `residual` is (R, SIZE) real minus simulated features.
    """
    count = len(residual)
    others = [np.arange(count) != r if count > 1 else slice(None) for r in range(count)]
    best, best_fraction = COVARIATES[0], -np.inf
    everywhere = [i for name in COVARIATES for channel in _CHANNELS for i in _index(channel, name)]
    for name in COVARIATES:
        index = np.concatenate([_index(channel, name) for channel in _CHANNELS])
        left = residual.copy()
        for r, rest in enumerate(others):
            left[r, index] -= _mean(model, residual, rest)[index]
        before, after = (
            model.losses(np.where(np.isin(np.arange(one.shape[1]), everywhere), one, 0)).sum()
            for one in (residual, left)
        )
        fraction = float((before - after) / max(before, THRESHOLDS.floor))
        if fraction > best_fraction:
            best, best_fraction = name, fraction
    return Patch(
        _effect(model, _mean(model, residual, slice(None)), best),
        best,
        float(np.clip(best_fraction, 0, 1)),
        [_effect(model, _mean(model, residual, rest), best) for rest in others],
    )


def _effect(model: Model, mean: np.ndarray, best: str) -> Effect:
    # The bins of the covariate, with the mean difference of the features in each.
    axis = model.evidence[0].axes[best]
    sigma = mean_sigma(model)[axis.start : axis.start + axis.bins]
    values = {'covariate_index': float(COVARIATES.index(best))}
    values.update({f'edge_{i}': edge for i, edge in enumerate(axis.edges)})
    bias, variance, loss = (mean[_index(channel, best)] for channel in _CHANNELS)
    for i in range(axis.bins):
        values[f'bias_{i}'] = float(np.clip(bias[i] * sigma[i], -1, 1))
        values[f'scale_{i}'] = float(np.clip(np.exp(variance[i] / 2), 0.1, 10))
        values[f'loss_{i}'] = float(np.clip(loss[i], 0, 1))
    effect: Effect = ResidualPatch(**values)
    return effect


def _index(channel: str, axis: str) -> np.ndarray:
    return np.array([i for i, f in enumerate(LAYOUT) if f.channel == channel and f.axis == axis])


def _mean(model: Model, residual: np.ndarray, chosen: Any) -> np.ndarray:
    good = model.good[chosen]
    return np.where(good, residual[chosen], 0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)

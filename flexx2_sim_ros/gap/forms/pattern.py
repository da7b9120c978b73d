"""The map of a fixed pattern: the mean error of each pixel over all recordings."""

from collections.abc import Sequence

from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.samples import frames_of, mean_error, shift_of
import numpy as np

_SEED = 0  # the same for all, so that maps without one recording have what is unknown in common


def pixel_errors(scene: PlacedScene, effects: dict[str, dict[str, float]]) -> np.ndarray:
    """
    Return the errors of a recording's pixels that other effects do not explain, (2, H, W).

    First sums of errors in metres times weights, then weights in 1/m^2.
    """
    shifts = shift_of(scene, effects)
    sums, weights = out = np.zeros((2, *shifts.shape[1:]))
    for shift, t in zip(shifts, frames_of(scene.recording), strict=True):
        cover = scene.covariates[int(t) if len(scene.covariates) > 1 else 0]
        error, count = mean_error(scene, int(t))
        error = error - shift
        with np.errstate(invalid='ignore'):
            good = cover.inside & (np.abs(error) < 6 * cover.sigma)
        weight = np.where(good, 1 / (cover.sigma**2 / count + FORMS.grain**2), 0.0)
        sums += weight * np.where(good, error, 0.0)
        weights += weight
    return out


def map_of(errors: Sequence[np.ndarray]) -> np.ndarray:
    """
    Return a map, (H, W) metres, as recordings have it in common, from their `pixel_errors`.

    It is drawn at random of those that agree with the recordings, two or more. Their mean would be
    too smooth: a pixel of which nothing is known has a fixed error as well. It is 0 if nothing is
    in common.
    """
    sums, weights = np.array(errors).swapaxes(0, 1)
    # Products of two recordings' errors have the map's variance as their mean, whatever the
    # noise is.
    products = sums.sum(axis=0) ** 2 - (sums**2).sum(axis=0)
    pairs = weights.sum(axis=0) ** 2 - (weights**2).sum(axis=0)
    variance = products.sum() / pairs.sum() if pairs.any() else 0.0
    if variance <= 0:
        return np.zeros(sums.shape[1:])
    known = weights.sum(axis=0) + 1 / variance
    unknown = np.random.default_rng(_SEED).standard_normal(known.shape) / np.sqrt(known)
    return np.asarray(sums.sum(axis=0) / known + unknown)

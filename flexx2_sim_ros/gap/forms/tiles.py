"""How far a recording is from its simulation, tile by tile of the image."""

from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.features.simulation import PlacedScene
import numpy as np

_PLACES = np.linspace(*FORMS.quantiles)


def tile_distance(scene: PlacedScene, real: np.ndarray, simulated: np.ndarray) -> float:
    """
    Compare two recordings of a scene.

    Parameters
    ----------
    scene : PlacedScene
        Of the recording.
    real, simulated : numpy.ndarray
        (T, H, W) metres, NaN where invalid.

    Returns
    -------
    float
        Mean over tiles of the Wasserstein-1 distance of their errors in sigma_z, plus the mean
        absolute difference of the fraction of invalid pixels.

    """
    shift = invalid = tiles = 0.0
    one, other = (_errors(scene, depth) for depth in (real, simulated))
    compared = np.isfinite(one).any(axis=1) | np.isfinite(other).any(axis=1)
    for a, b in zip(one[compared], other[compared], strict=True):
        mine, its = a[np.isfinite(a)], b[np.isfinite(b)]
        invalid += abs(len(mine) - len(its)) / len(a)
        if len(mine) > len(_PLACES) and len(its) > len(_PLACES):
            shift += float(np.abs(_quantiles(mine) - _quantiles(its)).mean())
            tiles += 1
    return shift / max(tiles, 1.0) + invalid / max(float(compared.sum()), 1.0)


def _quantiles(errors: np.ndarray) -> np.ndarray:
    return np.sort(errors)[np.rint(_PLACES * (len(errors) - 1)).astype(int)]


def _errors(scene: PlacedScene, depth: np.ndarray) -> np.ndarray:
    # (tiles, T * side * side) errors in sigma, NaN for pixels that are invalid or not compared.
    side = FORMS.tile
    frames = []
    for t, image in enumerate(depth):
        cover = scene.covariates[t if len(scene.covariates) > 1 else 0]
        with np.errstate(invalid='ignore', divide='ignore'):
            error = np.clip((image - cover.clean) / cover.sigma, -FORMS.clip, FORMS.clip)
        error[~cover.compared] = np.nan
        height, width = (n // side for n in image.shape)
        part = error[: height * side, : width * side].reshape(height, side, width, side)
        frames.append(part.transpose(0, 2, 1, 3).reshape(height * width, side * side))
    return np.concatenate(frames, axis=1)

"""What effects change at single pixels: how many pixels of each bin change by how much."""

from collections.abc import Sequence

from flexx2_sim_ros.gap.calibration.features import FEATURES, MEASURES
from flexx2_sim_ros.gap.data.axes import BINS
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
import numpy as np

_STEPS = FEATURES.change_steps
UNCHANGED = _STEPS  # class of pixels that an effect leaves alone
CLASSES = 2 * _STEPS + 2  # nearer, unchanged, farther; lost or gained
UNITS = ('metres', 'sigma')


def count_changes(
    before: np.ndarray, after: np.ndarray, scenes: Sequence[PixelCovariates]
) -> np.ndarray:
    """
    Count pixels by bin and by how far an effect shifts their depth.

    Parameters
    ----------
    before, after : numpy.ndarray
        (T, H, W) metres, simulated without and with effects from the same random numbers. Not
        finite or 0: no depth.
    scenes : sequence of PixelCovariates
        One for each frame, or one for all.

    Returns
    -------
    numpy.ndarray
        (2, BINS, CLASSES) float32. First shifts in metres, then in sigma_z. A class has twice the
        size of the one before it. The last class has the pixels whose depth is lost or gained.

    """
    out = np.zeros((len(UNITS), BINS * CLASSES))
    pixels = bins = np.zeros(0, int)
    for t in range(0, len(before), MEASURES.every):
        scene = scenes[t] if len(scenes) > 1 else scenes[0]
        if t == 0 or len(scenes) > 1:
            pixels, bins = _sorted_pixels(scene)
        for counts, classes in zip(out, _classes(before[t], after[t], scene.sigma), strict=True):
            own = classes[pixels]
            seen = own >= 0
            counts += np.bincount(bins[seen] * CLASSES + own[seen], minlength=BINS * CLASSES)
    return out.reshape(len(UNITS), BINS, CLASSES).astype(np.float32)


def _sorted_pixels(scene: PixelCovariates) -> tuple[np.ndarray, np.ndarray]:
    # Index of each pixel of each run in the flattened image, and its bin.
    width = scene.clean.shape[1]
    rows = np.repeat(np.arange(len(scene.first) - 1), np.diff(scene.first))
    start, end, bins = scene.runs.astype(int).T
    length = end - start
    first = rows * width + start - (np.cumsum(length) - length)
    return np.arange(length.sum()) + np.repeat(first, length), np.repeat(bins, length)


def _classes(before: np.ndarray, after: np.ndarray, sigma: np.ndarray) -> list[np.ndarray]:
    # (H W,) class of each pixel in metres and in sigma_z, -1 where neither has a depth.
    with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
        had, has = (np.isfinite(depth) & (depth > 0) for depth in (before, after))
        shift = np.where(had & has, after - before, 0)
        out = []
        for size, least in ((shift, FEATURES.change_m), (shift / sigma, FEATURES.change_sigma)):
            # Below the smallest size, the step is 0.
            size = np.nan_to_num(size)
            step = np.clip(np.floor(np.log2(np.abs(size) / least)) + 1, 0, _STEPS)
            place = _STEPS + np.sign(size) * step
            place = np.where(had & has, place, np.where(had | has, CLASSES - 1, -1))
            out.append(place.astype(int).ravel())
    return out

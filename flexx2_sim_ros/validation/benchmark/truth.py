"""
Where an effect really shows: the blind camera with it against the same camera without.

Pixels are grouped into cells by recording, distance, incidence, place in the picture, edge and
reflectivity. A cell is affected when the mean, the spread, the share of invalid pixels or the
correlations of its residuals differ by more than what matters. Means over thousands of samples
leave no noise to speak of; the reference is the scene as the camera truly saw it, so nuisances do
not count.
"""

import math

from flexx2_sim_ros.validation.blind.campaign import BlindCamera, Observer
from flexx2_sim_ros.validation.blind.frame import Frame
from flexx2_sim_ros.validation.blind.scene_set import SceneSet
from flexx2_sim_ros.validation.blind.views import View
from numba import njit
import numpy as np

# What matters: mean, log variance, invalid share, gross share, correlation to the frame before
# and to the pixel beside. The prototype's equivalence tolerances.
TOLERANCE = np.array([0.10, 0.10, 0.008, 0.004, 0.04, 0.04])
# Metres, degrees, shares (of the half-diagonal, the width, the height), 0..1, 1/m^2, 0 or 1,
# seconds, metres per second, number.
COVARIATES = (
    'distance',
    'incidence',
    'radius',
    'x',
    'y',
    'reflectivity',
    'amplitude',
    'edge',
    'uptime',
    'speed',
    'recording',
)
TILES = 3, 4  # rows and columns
_SHARES = 6, 4, TILES[0] * TILES[1], 2, 2  # distance, incidence, tile, edge, dark
_PER_RECORDING = math.prod(_SHARES)
_SUMS = 9
_SAMPLES = 12  # pixels of a cell whose covariates are kept
_CLIP = 6.0
_SURE = 4.0  # standard deviations
_ENOUGH = 1500  # samples for a cell to be scored


class Cells:
    """
    Sums over the cells of a campaign.

    Parameters
    ----------
    scenes : SceneSet
    sigma_factor : float
        The true noise over the paper's, known here and taken off.

    Attributes
    ----------
    sums : numpy.ndarray
        (cells, 9) float64.
    samples : numpy.ndarray
        (cells, 12, 11) float32: `COVARIATES` of some pixels of each cell, NaN for no more.

    """

    def __init__(self, scenes: SceneSet, sigma_factor: float = 1.0) -> None:
        """Start with nothing."""
        self._scenes, self._factor = scenes, sigma_factor
        cells = scenes.key.recordings * _PER_RECORDING
        self.sums = np.zeros((cells, _SUMS))
        self.samples = np.full((cells, _SAMPLES, len(COVARIATES)), np.nan, np.float32)
        self._filled = np.zeros(cells, np.int64)
        self._rng = np.random.default_rng(0)
        self._before: np.ndarray | None = None
        self._kept: tuple[object, np.ndarray] | None = None

    def watch(self, recording: int, frame: Frame) -> None:
        """Take a frame in; an `Observer`."""
        view = self._scenes.true_view(recording, frame.index)
        if self._kept is None or self._kept[0] is not view:
            self._kept = view, self._cell_of(recording, view)
            self._keep_samples(recording, frame, view, self._kept[1])
        if frame.index == 0:
            self._before = None
        # Nothing measured, nothing there: not a sample.
        with np.errstate(divide='ignore', invalid='ignore'):
            residual = (frame.depth - view.depth) / (view.sigma * np.float32(self._factor))
        residual = np.where(view.sigma > 0, residual, np.nan).astype(np.float32)
        cells = self._kept[1]
        _add(
            residual,
            residual if self._before is None else self._before,
            self._before is not None,
            cells,
            self.sums,
        )
        self._before = residual

    def _cell_of(self, recording: int, view: View) -> np.ndarray:
        height, width = view.depth.shape
        top = view.optics.mode.range_max
        distance = np.clip(np.nan_to_num(view.depth) / min(top, 5.0) * 6, 0, 5.99).astype(int)
        theta = np.degrees(np.arccos(np.clip(view.cosine, 0, 1)))
        incidence = np.digitize(theta, (20, 45, 65))
        y, x = np.mgrid[:height, :width]
        tile = (y * TILES[0] // height) * TILES[1] + x * TILES[1] // width
        edge, dark = view.near_edge.astype(int), (view.reflectivity < 0.2).astype(int)
        cell = np.zeros((height, width), np.int64)
        for index, count in zip((distance, incidence, tile, edge, dark), _SHARES, strict=True):
            cell = cell * count + index
        cell += recording * _PER_RECORDING
        # What the mode does not measure is no place for the base model either; it is kept, for
        # an effect may put something there.
        return np.where(np.isfinite(view.depth), cell, -1)

    def _keep_samples(self, recording: int, frame: Frame, view: View, cells: np.ndarray) -> None:
        height, width = view.depth.shape
        path = self._scenes.scenes[recording].path
        # Some of each view, so that a moving camera's cells know more than the first of them.
        most = 3 if path.moving else _SAMPLES
        pixels = self._rng.permutation(np.flatnonzero(cells >= 0))
        pixels = pixels[np.argsort(cells.ravel()[pixels], kind='stable')]
        place = cells.ravel()[pixels]
        rank = np.arange(len(place)) - np.searchsorted(place, place)
        slot = self._filled[place] + rank
        chosen = (rank < most) & (slot < _SAMPLES)
        pixels, place, slot = pixels[chosen], place[chosen], slot[chosen]
        y, x = pixels // width, pixels % width
        across, down = x - (width - 1) / 2, y - (height - 1) / 2
        theta = np.degrees(np.arccos(np.clip(view.cosine, 0, 1)))
        values = (
            view.depth.ravel()[pixels],
            theta.ravel()[pixels],
            np.hypot(across, down) / math.hypot(width / 2, height / 2),
            (x + 0.5) / width,
            (y + 0.5) / height,
            view.reflectivity.ravel()[pixels],
            view.amplitude.ravel()[pixels],
            view.near_edge.ravel()[pixels],
            frame.uptime,
            math.hypot(*path.velocity),
            recording,
        )
        for k, value in enumerate(values):
            self.samples[place, slot, k] = value
        np.maximum.at(self._filled, place, slot + 1)


@njit(cache=True)
def _add(residual, before, has_before, cells, sums):
    height, width = residual.shape
    for y in range(height):
        for x in range(width):
            cell = cells[y, x]
            if cell < 0:
                continue
            row = sums[cell]
            row[0] += 1
            raw = residual[y, x]
            if math.isnan(raw):
                continue
            e = min(max(raw, -_CLIP), _CLIP)
            row[1] += 1
            row[2] += e
            row[3] += e * e
            if abs(raw) >= _CLIP:
                row[4] += 1
            if has_before and before[y, x] == before[y, x]:
                row[5] += 1
                row[6] += e * min(max(before[y, x], -_CLIP), _CLIP)
            if x + 1 < width and cells[y, x + 1] == cell:
                beside = residual[y, x + 1]
                if beside == beside:
                    row[7] += 1
                    row[8] += e * min(max(beside, -_CLIP), _CLIP)


def features(sums: np.ndarray) -> np.ndarray:
    """Return (cells, 6): mean, log variance, invalid, gross, two correlations; NaN for none."""
    with np.errstate(divide='ignore', invalid='ignore'):
        mean = sums[:, 2] / sums[:, 1]
        variance = np.maximum(sums[:, 3] / sums[:, 1] - mean**2, 1e-4)
        frames = (sums[:, 6] / sums[:, 5] - mean**2) / variance
        beside = (sums[:, 8] / sums[:, 7] - mean**2) / variance
        return np.stack(
            [
                mean,
                np.log(variance),
                1 - sums[:, 1] / sums[:, 0],
                sums[:, 4] / sums[:, 1],
                frames,
                beside,
            ],
            axis=1,
        )


def affected(with_effect: Cells, without: np.ndarray) -> dict[str, np.ndarray]:
    """
    Compare.

    Parameters
    ----------
    with_effect : Cells
        Of the case's camera.
    without : numpy.ndarray
        (cells, 9) sums of the same scenes without any effect.

    Returns
    -------
    dict of str to numpy.ndarray
        Of the cells with enough samples: ``count``, ``affected`` (bool), ``difference`` (6) and
        ``samples`` (12, 11), see `Cells`.

    """
    sums = with_effect.sums
    enough = (sums[:, 0] >= _ENOUGH) & (without[:, 0] >= _ENOUGH)
    one, other = features(sums[enough]), features(without[enough])
    difference = one - other
    # Valid in one and not in the other: the share says so, the rest says nothing.
    difference = np.nan_to_num(difference)
    fewest = np.minimum(sums[enough, 1], without[enough, 1])
    count = sums[enough, 0]
    samples = with_effect.samples[enough]
    edge = samples[:, 0, COVARIATES.index('edge')]
    limit = np.maximum(TOLERANCE, _SURE * _noise(other, fewest, edge))
    few = fewest < _ENOUGH / 3
    difference[few, 0:2] = 0
    difference[few, 3:] = 0
    return {
        'count': count,
        'affected': (np.abs(difference) > limit).any(axis=1),
        'difference': difference.astype(np.float32),
        'samples': samples,
    }


def _noise(values: np.ndarray, count: np.ndarray, edge: np.ndarray) -> np.ndarray:
    # Standard deviation of the differences, (cells, 6), were there no effect.
    # An edge moves as a whole: its pixels count for one in this many.
    alone = np.sqrt(2 * (1 + 11 * edge) / np.maximum(count, 1))
    deviation = np.sqrt(np.exp(values[:, 1]))
    gross = np.sqrt(np.clip(values[:, 3] * (1 - values[:, 3]), 1e-6, 1))
    return np.nan_to_num(
        alone[:, None]
        * np.stack(
            [
                deviation,
                np.full(len(count), 1.5),
                gross,
                gross,
                np.ones(len(count)),
                np.ones(len(count)),
            ],
            axis=1,
        ),
        nan=1.0,
    )


def undisturbed(camera: BlindCamera) -> np.ndarray:
    """Return the sums of a camera without effects, from the cache of its scenes."""

    def make() -> dict[str, np.ndarray]:
        cells = Cells(camera.scenes, camera.sigma_factor)
        watch: Observer = cells.watch
        for recording in range(camera.scenes.key.recordings):
            for frame in camera.frames(recording):
                watch(recording, frame)
        return {'sums': cells.sums}

    return camera.scenes.cached('undisturbed', make)['sums']

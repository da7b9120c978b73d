"""
Where an effect really acts: the blind camera with it against the same camera without.

Both cameras take the same frames with the same random numbers, so most of the noise cancels. In
each cell of the scorer's partition (`partition.py`), statistics of their errors are compared. A
cell is affected if one of them differs significantly and by more than its tolerance. The
reference is the scene as the camera truly saw it: nuisances, such as errors of pose, do not
count.
"""

from collections.abc import Iterator
from dataclasses import replace
import math

from flexx2_sim_ros.physics.compiled import loop
import numpy as np
from study.benchmark.partition import partition_of
from study.blind.campaign import BlindCamera
from study.blind.frame import Frame

# What matters, the definition that the diagnosis also has: a change of the mean (in sigma_z), of
# the log variance, of the fractions of invalid pixels and of gross errors, and of the
# correlations with the previous frame and with the next pixel of the row.
TOLERANCE = np.array([0.10, 0.10, 0.008, 0.004, 0.04, 0.04])
_INVALID = 2
_SUMS = 9
_CLIP = 6.0  # sigma_z; larger errors are gross
_FEWEST = 200  # valid errors of a cell, in both cameras, for their statistics to be compared


class Comparison:
    """Compares a camera with the same camera without effects while it records."""

    def __init__(self, camera: BlindCamera) -> None:
        """Set all sums to zero."""
        self._scenes, self._factor = camera.scenes, camera.sigma_factor
        self._plain = BlindCamera(replace(camera.case, effects={}), camera.scenes)
        self._partition = partition_of(camera.scenes)
        frames = camera.scenes.key.frames
        # Frames, with and without effects, cells, sums.
        self._sums = np.zeros((frames, 2, self._partition.count, _SUMS))
        self._before = np.zeros((2, *camera.scenes.optics.shape), np.float32)
        self._others: Iterator[Frame] = iter(())

    def watch(self, recording: int, frame: Frame) -> None:
        """Add a frame of the camera; an `Observer`."""
        if frame.index == 0:
            self._others = self._plain.frames(recording)
            self._before[:] = np.nan
        view = self._scenes.true_view(recording, frame.index)
        cells = self._partition.cells[self._scenes.slot(recording, frame.index)]
        sigma = np.where(view.sigma > 0, view.sigma * np.float32(self._factor), np.nan)
        for i, one in enumerate((frame, next(self._others))):
            errors = ((one.depth - view.depth) / sigma).astype(np.float32)
            _add(errors, self._before[i], cells, self._sums[frame.index, i])
            self._before[i] = errors

    def affected(self) -> dict[str, np.ndarray]:
        """
        Say which of the campaign's sampled pixels are affected.

        Returns ``samples`` (S, 11), see `partition.COVARIATES`, and ``affected`` (S,) bool.
        """
        cells = affected_cells(self._sums)
        return {
            'samples': self._partition.samples,
            'affected': cells[self._partition.sample_cells],
        }


def affected_cells(sums: np.ndarray) -> np.ndarray:
    """
    Say which cells differ by more than matters.

    `sums`: (frames, 2, cells, 9) with and without effects. Returns (cells,) bool. Differences are
    shrunk towards their mean over all cells, as far as they are uncertain (empirical Bayes [Efron
    and Morris 1975]); their standard errors are those of the jackknife over frames [Efron and
    Stein 1981].
    """
    total, frames = sums.sum(axis=0), len(sums)
    # With few valid errors, only the fraction of invalid pixels says something.
    few = total[:, :, 1].min(axis=0) < _FEWEST
    compared = ~few[:, None] | (np.arange(len(TOLERANCE)) == _INVALID)
    difference = compared * _difference(total)
    left_out = compared * [_difference(total - one) for one in sums]
    variance = (frames - 1) * left_out.var(axis=0)
    mean = difference.mean(axis=0)
    # The median: cells with a few enormous errors do not decide for all.
    between = np.maximum(difference.var(axis=0) - np.median(variance, axis=0), 0)
    trust = between / np.maximum(between + variance, 1e-12)
    return np.asarray((np.abs(mean + trust * (difference - mean)) > TOLERANCE).any(axis=1))


def _difference(sums: np.ndarray) -> np.ndarray:
    # (cells, 6) of the (2, cells, 9) sums with and without effects.
    return np.nan_to_num(features(sums[0]) - features(sums[1]))


def features(sums: np.ndarray) -> np.ndarray:
    """Return (cells, 6) statistics in the order of `TOLERANCE`; NaN where there are none."""
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


@loop()
def _add(errors, before, cells, sums):
    # Counts, sums and products of the errors of a frame, for each cell.
    height, width = errors.shape
    for y in range(height):
        for x in range(width):
            cell = cells[y, x]
            if cell < 0:
                continue
            row = sums[cell]
            row[0] += 1
            raw = errors[y, x]
            if math.isnan(raw):
                continue
            e = min(max(raw, -_CLIP), _CLIP)
            row[1] += 1
            row[2] += e
            row[3] += e * e
            if abs(raw) >= _CLIP:
                row[4] += 1
            if before[y, x] == before[y, x]:
                row[5] += 1
                row[6] += e * min(max(before[y, x], -_CLIP), _CLIP)
            if x + 1 < width and cells[y, x + 1] == cell:
                beside = errors[y, x + 1]
                if beside == beside:
                    row[7] += 1
                    row[8] += e * min(max(beside, -_CLIP), _CLIP)

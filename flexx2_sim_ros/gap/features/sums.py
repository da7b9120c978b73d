"""Sums over the pixels and frames of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.data.axes import BINS
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
from flexx2_sim_ros.gap.features.jumps import count_at_jumps
from flexx2_sim_ros.gap.features.pixel_patterns import count_depths, LATTICE_BIN, LATTICE_RANGE
from flexx2_sim_ros.gap.features.row_sums import (
    FrameSums,
    FrameTimes,
    gather_rows,
    PixelSums,
    RowSurfaces,
    WIDTH,
)
import numpy as np


@dataclass
class Sums:
    """
    Sums over the pixels and frames of a recording. Sums of two parts of it can be added.

    * `bins`: (BINS, WIDTH) float64, see `row_sums`.
    * `pairs`: (7,) float64, of the differences between frames: (sum^2 - sum of squares) and the
      number of pairs, over whole frames, rows and columns; and the sum of squares.
    * `losses`: (2,) float64: how much the squared change of the number of invalid pixels in a row
      exceeds that of independent pixels, and the number of pairs of pixels.
    * `spread`: (3,) float64: sum, sum of squares and count of each frame's log mean squared
      difference.
    * `mean`: (2, H, W) float32: per pixel the sum of errors (metres), and count.
    * `sigma`: (H, W) float32, sum of sigma_z where ``mean`` counts.
    * `lattice`: (2, N) histograms of depth and of distance along the ray. Steps of a phase are
      steps of that distance.
    * `jumps`: (4,) float64 numbers of depths at jumps; see `jumps.count_at_jumps`.
    """

    bins: np.ndarray
    pairs: np.ndarray
    losses: np.ndarray
    spread: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    lattice: np.ndarray | None
    jumps: np.ndarray


def accumulate(
    depth: np.ndarray,
    scenes: Sequence[PixelCovariates],
    fresh: np.ndarray,
    warm: int,
    lattice: bool = True,
    thin: bool = False,
) -> Sums:
    """
    Sum the frames of a recording, (T, H, W) float32 metres, NaN where invalid.

    `scenes` is one, or one a frame. (T,) bool `fresh` marks frames that do not directly follow the
    one before; `warm` frames after them are left out, while filters of the camera settle. With
    `lattice` the histograms of depth are made; `thin` uses every second row only.
    """
    frames = _frame_times(fresh, warm)
    frame_sums, pixel_sums = _sum_frames(depth, scenes, frames, thin)
    return Sums(
        pixel_sums.bins,
        _pairs(frame_sums, frames),
        _lost_rows(frame_sums, frames),
        _frame_spread(frame_sums, frames),
        pixel_sums.mean,
        pixel_sums.sigma,
        _depth_histogram(depth, scenes, frames) if lattice else None,
        _at_jumps(depth, scenes, frames),
    )


def _frame_times(fresh: np.ndarray, warm: int) -> FrameTimes:
    count, start = len(fresh), fresh.copy()
    start[:1] = True
    use, age = np.zeros(count, np.bool_), 0
    for t in range(count):
        age = 1 if start[t] else age + 1
        use[t] = age > warm
    times = ((np.arange(count) - (count - 1) / 2) / max(count - 1, 1)).astype(np.float32)
    return FrameTimes(start, use, times)


def _sum_frames(
    depth: np.ndarray, scenes: Sequence[PixelCovariates], frames: FrameTimes, thin: bool
) -> tuple[FrameSums, PixelSums]:
    count, height, width = depth.shape
    frame_sums = FrameSums(
        rows=np.zeros((count, 2, height), np.float32),
        columns=np.zeros((count, 2, width), np.float32),
        squares=np.zeros(count),
        invalid=np.zeros((count, height)),
    )
    pixel_sums = PixelSums(
        bins=np.zeros((BINS, WIDTH)),
        mean=np.zeros((2, height, width), np.float32),
        sigma=np.zeros((height, width), np.float32),
        errors=np.empty((3, height, width), np.float32),
    )
    still = len(scenes) == 1
    # A still scene is summed at once, with all its frames.
    for part in [slice(None)] if still else [slice(t, t + 1) for t in range(count)]:
        scene = scenes[0] if still else scenes[part.start]
        # Of noisier pixels only their validity is summed.
        sigma = np.where(scene.sigma <= scene.trusted, scene.sigma, np.float32(np.nan))
        gather_rows(
            depth[part],
            RowSurfaces(scene.clean, sigma, scene.inside, scene.first, scene.runs),
            FrameTimes(*(one[part] for one in frames)),
            FrameSums(*(one[part] for one in frame_sums)),
            pixel_sums,
            not still,
            2 if thin else 1,
        )
    return frame_sums, pixel_sums


def _depth_histogram(
    depth: np.ndarray, scenes: Sequence[PixelCovariates], frames: FrameTimes
) -> np.ndarray:
    histogram = np.zeros((2, int(LATTICE_RANGE / LATTICE_BIN)))
    for t in np.flatnonzero(frames.use).tolist():
        scene = scenes[0 if len(scenes) == 1 else t]
        count_depths(depth[t], scene.inside, scene.ray, histogram)
    return histogram


def _at_jumps(
    depth: np.ndarray, scenes: Sequence[PixelCovariates], frames: FrameTimes
) -> np.ndarray:
    # (4,) see `Sums`. Edges of a moving scene change sides by themselves.
    out, sides, still = np.zeros(4), np.zeros(depth.shape[1:], np.int8), len(scenes) == 1
    for t in np.flatnonzero(frames.use).tolist():
        scene = scenes[0] if still else scenes[t]
        follows = still and t > 0 and bool(frames.use[t - 1]) and not frames.start[t]
        count_at_jumps(depth[t], scene.clean, scene.sigma, scene.ends, follows, sides, out)
    return out


def _pairs(sums: FrameSums, frames: FrameTimes) -> np.ndarray:
    # (7,) see `Sums`. The square of a sum minus the sum of squares is twice the sum of products of
    # pairs.
    (row, row_number), (column, column_number) = (
        image.astype(float).transpose(1, 0, 2) for image in (sums.rows, sums.columns)
    )
    number, squares = row_number.sum(axis=1), sums.squares
    some = frames.use & (number > 1)
    return np.array(
        [
            f[some].sum()
            for f in (
                row.sum(axis=1) ** 2 - squares,
                number**2 - number,
                (row**2).sum(axis=1) - squares,
                (row_number**2).sum(axis=1) - number,
                (column**2).sum(axis=1) - squares,
                (column_number**2).sum(axis=1) - number,
                squares,
            )
        ]
    )


def _lost_rows(sums: FrameSums, frames: FrameTimes) -> np.ndarray:
    # (2,) see `Sums`: independent pixels change as often as they are invalid.
    use, (_, height), width = frames.use, sums.invalid.shape, sums.columns.shape[2]
    after = np.flatnonzero(use[1:] & use[:-1] & ~frames.start[1:]) + 1
    invalid, before = sums.invalid[after], sums.invalid[after - 1]
    excess = ((invalid - before) ** 2 - invalid - before).sum()
    return np.array([excess, float(width**2 * height * len(after))])


def _frame_spread(sums: FrameSums, frames: FrameTimes) -> np.ndarray:
    # (3,) see `Sums`.
    number = sums.rows[:, 1].astype(float).sum(axis=1)
    some = frames.use & (number > 1)
    value = np.log(np.maximum(sums.squares[some] / number[some], 1e-9))
    return np.array([value.sum(), (value**2).sum(), len(value)])

"""Statistics over a region's pixels: what the model assumes of them, in numbers."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.board_finding import Board
from flexx2_sim_ros.characterize.moments import Moments
import numpy as np

_THIN = 4000  # pixels that are enough for a frame's mean


@dataclass(frozen=True)
class Pixels:
    """
    What the pixels of a region are like; NaN where a single frame cannot say.

    Attributes
    ----------
    count : int
        Pixels that were measured.
    invalid : float
        Share of invalid pixels, of all pixels and frames in the region that no mask excludes.
    lag, right, down : float
        Correlation of the noise with the next frame, the next pixel in the row and the next one
        in the column. Of a single frame: of what is left of the plane.
    skewness, kurtosis : float
        Of the noise; 0 and 0 for a Gaussian.
    frame_spread : float
        Variance of the frames' means, relative to what independent pixels would give.
    drift : float
        Change of the frames' mean from first to last by a straight line, metres.
    flatness : float
        Root mean square distance of the mean depth from the plane, noise taken off, metres. Of a
        single frame: with its noise.
    pattern : float
        The same after a smooth (quadratic) surface is taken off: what differs from pixel to
        pixel and stays, metres.

    """

    count: int
    invalid: float
    lag: float
    right: float
    down: float
    skewness: float
    kurtosis: float
    frame_spread: float
    drift: float
    flatness: float
    pattern: float


class FrameMeans:
    """
    The mean error of every frame, over some of the region's pixels.

    ``region`` is (H, W) bool, ``reference`` (H, W) metres, about the mean depth.
    """

    def __init__(self, region: np.ndarray, reference: np.ndarray) -> None:
        """Choose the pixels."""
        v, u = np.nonzero(region)
        thin = slice(None, None, math.ceil(len(u) / _THIN))
        self.pixels = v[thin], u[thin]
        self._reference = reference[self.pixels]
        self._means: list[np.ndarray] = []

    def add(self, depth: np.ndarray) -> None:
        """Add (n, H, W) frames, metres, NaN where invalid."""
        error = depth[:, *self.pixels] - self._reference
        valid = np.isfinite(error)
        self._means.append(
            np.where(valid, error, 0.0).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
        )

    @property
    def series(self) -> np.ndarray:
        """Return (T,) means, metres."""
        return np.concatenate(self._means)


def pixel_statistics(
    board: Board, moments: Moments, usable: np.ndarray, means: FrameMeans, left_in: np.ndarray
) -> Pixels:
    """
    Summarise a region of a board whose plane is fitted to the mean depth.

    ``moments`` and ``means`` are of all frames; ``usable`` (H, W) bool are pixels with enough
    valid frames, ``left_in`` (H, W) the frames in which no mask excludes the pixel.
    """
    here = board.region & usable
    count = int(here.sum())
    invalid = 1.0 - float(moments.count[board.region].sum() / left_in[board.region].sum())
    v, u = np.nonzero(here)
    error = np.full(here.shape, np.nan)
    error[v, u] = moments.mean[v, u] - board.plane.depth(u, v)
    if moments.frames == 1:
        square = error**2
        right, down = (
            _correlation(error * _next(error, axis), square, _next(square, axis))
            for axis in (1, 0)
        )
        unknown = math.nan
        return Pixels(
            count,
            invalid,
            unknown,
            right,
            down,
            unknown,
            unknown,
            unknown,
            unknown,
            float(np.sqrt(np.nanmean(square))),
            unknown,
        )
    variance = np.where(here, moments.variance, np.nan)
    lag = _correlation(moments.lag, variance, variance)
    right = _correlation(moments.right, variance, _next(variance, 1))
    down = _correlation(moments.down, variance, _next(variance, 0))
    skewness, kurtosis = _tails(moments, here)
    series = means.series
    expected = float(np.nanmean(moments.variance[means.pixels])) / len(means.pixels[0])
    drift = float(np.polyfit(np.linspace(-0.5, 0.5, len(series)), series, 1)[0])
    # What moves the whole frame is no noise of a pixel's mean about its neighbours'.
    own = np.maximum(moments.variance[v, u] - series.var(ddof=1), 0.0)
    noise = float(np.mean(own / moments.count[v, u]))
    return Pixels(
        count,
        invalid,
        lag,
        right,
        down,
        skewness,
        kurtosis,
        float(series.var(ddof=1)) / expected if expected > 0 else math.nan,
        drift,
        _less(float(np.mean(error[v, u] ** 2)), noise),
        _less(float(np.mean(_unsmooth(u, v, error[v, u]) ** 2)), noise),
    )


def _next(image: np.ndarray, axis: int) -> np.ndarray:
    """Return the value of the next pixel along an axis, NaN after the last."""
    shifted = np.roll(image, -1, axis)
    shifted[(slice(None), -1) if axis else -1] = np.nan
    return shifted


def _correlation(covariance: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    good = np.isfinite(covariance) & np.isfinite(one) & np.isfinite(other)
    scale = math.sqrt(one[good].sum() * other[good].sum())
    return float(covariance[good].sum() / scale) if scale > 0 else math.nan


def _tails(moments: Moments, here: np.ndarray) -> tuple[float, float]:
    n = moments.count[here].astype(np.float64)
    second = moments.variance[here] * (n - 1) / n
    moving = (second > 0) & (n > 3)
    if not moving.any():
        return math.nan, math.nan
    n, second = n[moving], second[moving]
    skewness = np.mean(moments.third[here][moving] / second**1.5)
    # The kurtosis of a Gaussian's sample is 3 - 6 / (n + 1) on average.
    kurtosis = np.mean(moments.fourth[here][moving] / second**2 - 3 + 6 / (n + 1))
    return float(skewness), float(kurtosis)


def _unsmooth(u: np.ndarray, v: np.ndarray, error: np.ndarray) -> np.ndarray:
    scale = max(np.ptp(u), np.ptp(v), 1)
    x, y = (u - u.mean()) / scale, (v - v.mean()) / scale
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    return error - design @ np.linalg.lstsq(design, error, rcond=None)[0]


def _less(square: float, noise: float) -> float:
    return math.sqrt(max(square - noise, 0.0))

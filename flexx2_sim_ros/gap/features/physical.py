"""The gap in physical units."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from flexx2_sim_ros.gap.calibration.features import FEATURES, MEASURES
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
from flexx2_sim_ros.gap.features.features import likeness, noise_of
from flexx2_sim_ros.gap.features.pixel_patterns import count_errors
from flexx2_sim_ros.gap.features.row_sums import EXPECT, N2, VALID
from flexx2_sim_ros.gap.features.sums import Sums
import numpy as np

_REGIONS = AXES['region'].bins
_BIN_MM, _HALF, _NORMAL = MEASURES.bin_mm, MEASURES.half, MEASURES.normal
_SIGMAS = FEATURES.gross
# By how much each measure may change without mattering: the tolerances of the features. That of
# ``kl_nats`` is the divergence of two normal distributions that are a tolerance of bias apart.
TOLERANCES = {
    'wasserstein_sigma': FEATURES.tolerances['bias'],
    'edge_sigma': FEATURES.tolerances['bias'],
    'invalid_rate': FEATURES.tolerances['invalid'],
    'log_variance': FEATURES.tolerances['log_variance'],
    'correlation': FEATURES.tolerances['neighbour'],
    'lag': FEATURES.tolerances['lag'],
    'kl_nats': FEATURES.tolerances['bias'] ** 2 / 2,
}
UNITS = ('wasserstein_mm', *TOLERANCES)
# What the distance of two recordings is made of, see `distance`; and their noise.
COUNTED = 'wasserstein_sigma', 'invalid_rate'
NOISE = 'log_variance', 'correlation', 'lag'


@dataclass(frozen=True)
class Measures:
    """
    Distributions of a recording's errors.

    * `millimetres`: (regions, bins) histogram of depth errors.
    * `normal`: (regions or tiles, bins) histogram of errors in sigma_z, clipped at 6.
    * `edges`: (bins,) the same of pixels at jumps and sharp bends, in the whole image.
    * `invalid`: (2, B) pixels, and invalid pixels, in each bin of distance, amplitude and
      incidence.
    * `noise`: (2, B) pairs of frames, and the log temporal variance, in sigma_z squared, likewise.
    * `correlation`, `lag`: correlation of the noise with that of the next pixel, and of the frame
      before.
    * `growth`: (3,) see `noise_growth`; counted in small tiles only, else 0.
    """

    millimetres: np.ndarray
    normal: np.ndarray
    edges: np.ndarray
    invalid: np.ndarray
    noise: np.ndarray
    correlation: float
    lag: float
    growth: np.ndarray


def fine_side(frames: int) -> int:
    """Return the side of small tiles that have enough errors in so many frames, pixels."""
    return max(MEASURES.tile, math.ceil(math.sqrt(2 * MEASURES.fewest / max(frames, 1))))


def histogram(
    depth: np.ndarray,
    scenes: Sequence[PixelCovariates],
    sums: Sums,
    side: int | None = None,
    at_edges: bool = True,
) -> Measures:
    """
    Count errors of a recording's frames, (T, H, W) metres, NaN where invalid.

    * `scenes`: one for a still scene, otherwise one for each frame.
    * `sums`: of the same frames.
    * `side`: errors in sigma_z are counted in tiles of so many pixels a side, in all frames.
      Without, in 12 regions of the image, in a third of the frames: that is enough there.
    * `at_edges`: whether errors at jumps and sharp bends are counted in the regions or tiles as
      well. A fitted pose puts jumps a part of a pixel aside, and that error is not the camera's.
    """
    height, width = depth.shape[1:]
    v, u = np.mgrid[:height, :width]
    regions = (v * 3 // height) * 4 + u * 4 // width
    columns = -(-width // (side or width))
    tiles = regions if side is None else (v // side) * columns + u // side
    count = _REGIONS if side is None else -(-height // side) * columns
    counts = np.zeros((_REGIONS, 2 * _HALF + 1), np.int64)
    normal, edges = np.zeros((count, _NORMAL), np.int64), np.zeros(_NORMAL, np.int64)
    for t in range(0, len(depth), MEASURES.every if side is None else 1):
        one = scenes[t] if len(scenes) > 1 else scenes[0]
        images = depth[t], one.clean, one.sigma, one.inside
        count_errors(*images, regions, tiles, at_edges, counts, normal, edges)
    s, (variance, lag, correlation) = sums.bins.T, noise_of(sums.bins)
    everywhere = AXES['all'].start
    return Measures(
        counts.astype(float),
        normal.astype(float),
        edges.astype(float),
        np.array([s[EXPECT][_SEEN], s[EXPECT][_SEEN] - s[VALID][_SEEN]]),
        np.array([s[N2][_SURFACES], variance[_SURFACES]]),
        float(np.nan_to_num(correlation[everywhere], posinf=0.0, neginf=0.0)),
        float(np.nan_to_num(likeness(lag[everywhere]))),
        np.zeros(len(MEASURES.apart)) if side is None else noise_growth(depth, scenes),
    )


def noise_growth(depth: np.ndarray, scenes: Sequence[PixelCovariates]) -> np.ndarray:
    """
    Return how noise differs between frames the farther these are apart, (3,).

    It tells one filter over frames from another: without any, frames that follow each other differ
    as much as others. The values are ln of the mean squared difference of the errors in sigma_z of
    a pixel, 2, 3 and 4 frames apart, over that of frames that follow each other; 0 with fewer than
    6 frames or too few pixels. They are of surfaces, without errors beyond 6 sigma_z. `depth` is
    (T, H, W) metres, NaN where invalid.
    """
    if len(depth) < MEASURES.apart[-1] + 2:
        return np.zeros(len(MEASURES.apart))
    shown = [scenes[t] if len(scenes) > 1 else scenes[0] for t in range(len(depth))]
    with np.errstate(invalid='ignore', divide='ignore'):
        errors = np.array(
            [(image - one.clean) / one.sigma for image, one in zip(depth, shown, strict=True)]
        )
        errors[~(np.abs(errors) < _SIGMAS)] = np.nan
    errors[~np.array([one.inside for one in shown])] = np.nan
    squares = []
    for apart in (1, *MEASURES.apart):
        differences = errors[apart:] - errors[:-apart]
        differences = differences[np.isfinite(differences)]
        squares.append(
            np.square(differences).mean() if len(differences) > MEASURES.fewest_pairs else np.nan
        )
    with np.errstate(invalid='ignore', divide='ignore'):
        growth = np.log(np.array(squares[1:]) / squares[0])
    return np.where(np.isfinite(growth), growth, 0.0)


def _bins_of(*names: str) -> np.ndarray:
    return np.concatenate([np.arange(AXES[n].start, AXES[n].start + AXES[n].bins) for n in names])


# The covariates of `Measures.noise`, and of the first bins of `Measures.invalid`.
SURFACES = 'distance', 'log_amplitude', 'incidence'
_SURFACES = _bins_of(*SURFACES)
_SEEN = np.concatenate([_SURFACES, _bins_of('edge', 'beyond')])


def distances(real: Measures, other: Measures) -> dict[str, float]:
    """
    Return how far two recordings of one scene are apart, in each of `UNITS`.

    ``wasserstein_mm``, ``wasserstein_sigma``: Wasserstein-1 distance of the depth errors in each
    of 12 regions of the image, in millimetres, and in sigma_z (errors are clipped at 6 sigma_z; in
    small tiles if the histograms are), mean over regions; ``edge_sigma``: the same at jumps and
    sharp bends; ``invalid_rate``: mean absolute difference of the fraction of invalid pixels over
    bins of distance, amplitude, incidence, edges and beyond range; ``log_variance``: mean absolute
    difference of the log temporal variance over bins of distance, amplitude and incidence;
    ``correlation``, ``lag``: absolute difference of the correlation with the next pixel, and with
    the frame before; ``kl_nats``: Kullback-Leibler divergence of the real normalised errors from
    the simulated ones.
    """
    edges = [one[None] for one in (real.edges, other.edges)]
    return {
        'wasserstein_mm': _wasserstein(real.millimetres, other.millimetres) * _BIN_MM,
        'wasserstein_sigma': _wasserstein(real.normal, other.normal) * (2 * _SIGMAS / _NORMAL),
        'edge_sigma': _wasserstein(*edges) * (2 * _SIGMAS / _NORMAL),
        'invalid_rate': _difference_of_rates(real.invalid, other.invalid),
        'log_variance': _difference_of_noise(real.noise, other.noise),
        'correlation': abs(real.correlation - other.correlation),
        'lag': abs(real.lag - other.lag),
        'kl_nats': _divergence(real.normal.sum(axis=0), other.normal.sum(axis=0)),
    }


def distance(apart: Mapping[str, float]) -> float:
    """
    Return how far two recordings are apart as one number, from their `distances`.

    It is the Wasserstein distance in units of 0.1 sigma_z plus the difference of the fraction of
    invalid pixels in units of 0.8 %, the diagnosis' tolerances. Below 1 a difference does not
    matter.
    """
    return in_tolerances(apart, COUNTED)


def in_tolerances(apart: Mapping[str, float], units: Sequence[str]) -> float:
    """Return the sum of some of `distances`, each over its tolerance."""
    return sum(apart[unit] / TOLERANCES[unit] for unit in units)


def mismatch(real: Measures, other: Measures) -> float:
    """
    Return a smooth counterpart of `distance`, to fit parameters by.

    The Wasserstein distance of two samples of one distribution is not zero and hides small shifts.
    In the energy distance (Szekely and Rizzo 2013), the square of a small shift is added to what
    noise leaves. Regions far apart count in proportion, and not by their square.

    It is the mean over regions or tiles of the energy distance of errors in sigma_z, plus the mean
    over bins of the squared difference of the fraction of invalid pixels, plus that of
    `noise_growth`; all in squared tolerances, and as a pseudo-Huber loss.
    """
    shifted = TOLERANCES['wasserstein_sigma'] ** 2 / math.sqrt(math.pi)
    to_energy = 2 * (2 * _SIGMAS / _NORMAL) / shifted
    grown = (real.growth - other.growth) / FEATURES.tolerances['log_variance']
    return (
        _over_regions(
            real.normal, other.normal, lambda gaps: _huber(to_energy * (gaps**2).sum(axis=1))
        )
        + _over_bins(
            real.invalid,
            other.invalid,
            lambda gaps: _huber((gaps / TOLERANCES['invalid_rate']) ** 2),
        )
        + float(_huber(grown**2).mean())
    )


def _huber(squares: np.ndarray) -> np.ndarray:
    return np.sqrt(1 + squares / MEASURES.bend**2) - 1


def _wasserstein(real: np.ndarray, other: np.ndarray) -> float:
    # In bins, of (regions, bins) histograms.
    return _over_regions(real, other, lambda gaps: np.abs(gaps).sum(axis=1))


def _over_regions(real: np.ndarray, other: np.ndarray, size: Callable[..., Any]) -> float:
    # A function of the (regions, bins) differences of the distributions, mean over regions by
    # their number of pixels.
    pixels = real.sum(axis=1), other.sum(axis=1)
    good = (pixels[0] > MEASURES.fewest) & (pixels[1] > MEASURES.fewest)
    if not good.any():
        return 0.0
    one, two = (a[good] / n[good, None] for a, n in zip((real, other), pixels, strict=True))
    apart = size(np.cumsum(one - two, axis=1))
    return float(np.average(apart, weights=pixels[0][good]))


def _difference_of_rates(real: np.ndarray, other: np.ndarray) -> float:
    return _over_bins(real, other, np.abs)


def _over_bins(real: np.ndarray, other: np.ndarray, size: Callable[..., Any]) -> float:
    # Mean over bins of a function of the difference of rates, by the number of pixels.
    good = (real[0] > MEASURES.fewest) & (other[0] > MEASURES.fewest)
    if not good.any():
        return 0.0
    rates = [one[1][good] / one[0][good] for one in (real, other)]
    return float(np.average(size(rates[0] - rates[1]), weights=real[0][good]))


def _difference_of_noise(real: np.ndarray, other: np.ndarray) -> float:
    good = (real[0] > MEASURES.fewest) & (other[0] > MEASURES.fewest)
    good &= np.isfinite(real[1]) & np.isfinite(other[1])
    if not good.any():
        return 0.0
    return float(np.average(np.abs(real[1][good] - other[1][good]), weights=real[0][good]))


def _divergence(real: np.ndarray, other: np.ndarray) -> float:
    p, q = real + 0.5, other + 0.5
    p, q = p / p.sum(), q / q.sum()
    return float((p * np.log(p / q)).sum())

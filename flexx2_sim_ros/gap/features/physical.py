"""The gap in physical units."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.features import MEASURES
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.data.covariates import PixelCovariates
from flexx2_sim_ros.gap.features.row_sums import EXPECT, N2, N_NEIGHBOUR, NEIGHBOUR, SQUARE2, VALID
from flexx2_sim_ros.gap.features.sums import Sums
import numpy as np

_REGIONS = AXES['region'].bins
_BIN_MM, _HALF, _NORMAL = MEASURES.bin_mm, MEASURES.half, MEASURES.normal
UNITS = ('wasserstein_mm', 'invalid_rate', 'kl_nats', 'correlation')


@dataclass(frozen=True)
class Measures:
    """
    Distributions of a recording's errors.

    Attributes
    ----------
    millimetres : numpy.ndarray
        (regions, bins) histogram of depth errors.
    normal : numpy.ndarray
        (bins,) histogram of errors in sigma.
    invalid : numpy.ndarray
        (2, B) pixels and lost pixels a bin of distance, amplitude and incidence.
    correlation : float
        Of neighbours' noise.

    """

    millimetres: np.ndarray
    normal: np.ndarray
    invalid: np.ndarray
    correlation: float


def histogram(depth: np.ndarray, scenes: Sequence[PixelCovariates], sums: Sums) -> Measures:
    """Count errors of a recording's frames (a third of them is enough)."""
    height, width = depth.shape[1:]
    v, u = np.mgrid[:height, :width]
    regions = (v * 3 // height) * 4 + u * 4 // width
    size = 2 * _HALF + 1
    counts, normal = np.zeros(_REGIONS * size), np.zeros(_NORMAL)
    for t in range(0, len(depth), MEASURES.every):
        scene = scenes[t] if len(scenes) > 1 else scenes[0]
        with np.errstate(invalid='ignore'):
            inner = np.isfinite(depth[t]) & np.isfinite(scene.clean)
        error = depth[t][inner] - scene.clean[inner]
        place = np.clip(np.rint(error * (1000 / _BIN_MM)), -_HALF, _HALF).astype(int) + _HALF
        region = regions[inner]
        counts += np.bincount(region * size + place, minlength=len(counts))
        e = np.clip(error / scene.sigma[inner], -5.999, 5.999)
        normal += np.bincount(((e + 6) * (_NORMAL / 12)).astype(int), minlength=_NORMAL)
    s = sums.bins.T
    names = ('distance', 'log_amplitude', 'incidence', 'edge', 'beyond')
    chosen = np.concatenate(
        [np.arange(AXES[n].start, AXES[n].start + AXES[n].bins) for n in names]
    )
    i = AXES['all'].start
    with np.errstate(invalid='ignore', divide='ignore'):
        correlation = float(s[NEIGHBOUR, i] / s[N_NEIGHBOUR, i] / (s[SQUARE2, i] / s[N2, i]))
    return Measures(
        counts.reshape(_REGIONS, size),
        normal,
        np.array([s[EXPECT][chosen], s[EXPECT][chosen] - s[VALID][chosen]]),
        correlation if np.isfinite(correlation) else 0.0,
    )


def distances(real: Measures, other: Measures) -> dict[str, float]:
    """
    Return how far two recordings of one scene are apart.

    Returns
    -------
    dict
        ``wasserstein_mm``: Wasserstein-1 distance of the depth errors a region, mean over regions;
        ``invalid_rate``: mean absolute difference of the rate of invalid pixels over bins of
        distance, amplitude, incidence, edges and beyond range; ``kl_nats``: Kullback-Leibler
        divergence of the normalised errors from those simulated; ``correlation``: absolute
        difference of neighbouring pixels' correlation.

    """
    total, weight = 0.0, 0.0
    for one, two in zip(real.millimetres, other.millimetres, strict=True):
        if one.sum() > MEASURES.fewest and two.sum() > MEASURES.fewest:
            gap = np.abs(np.cumsum(one / one.sum() - two / two.sum())).sum() * _BIN_MM
            total += gap * one.sum()
            weight += one.sum()
    seen, lost = real.invalid
    seen2, lost2 = other.invalid
    good = (seen > MEASURES.fewest) & (seen2 > MEASURES.fewest)
    invalid = (
        float(
            np.average(
                np.abs(lost[good] / seen[good] - lost2[good] / seen2[good]), weights=seen[good]
            )
        )
        if good.any()
        else 0.0
    )
    p, q = real.normal + 0.5, other.normal + 0.5
    p, q = p / p.sum(), q / q.sum()
    return {
        'wasserstein_mm': total / weight if weight else 0.0,
        'invalid_rate': invalid,
        'kl_nats': float((p * np.log(p / q)).sum()),
        'correlation': abs(real.correlation - other.correlation),
    }

"""How much a covariate tells about what effects change at a pixel."""

from collections.abc import Sequence

from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.features.changes import UNCHANGED
import numpy as np
from scipy import stats

_ALL = AXES['all'].start
_ALONG = (
    'distance',
    'fine_distance',
    'incidence',
    'radius',
    'region',
    'log_amplitude',
    'concavity',
    'speed',
)


def told(changes: Sequence[np.ndarray]) -> dict[str, float]:
    """
    Return how much each covariate tells about what effects change at a pixel.

    Every pixel counts the same, so a few large changes at edges do not hide the rest. An effect
    may be the same everywhere in metres, such as an offset, or in sigma_z, such as more noise. The
    unit is taken in which covariates tell less.

    Parameters
    ----------
    changes : sequence of numpy.ndarray
        (2, BINS, CLASSES) of each recording, see `features.changes.count_changes`.

    Returns
    -------
    dict of str to float
        By axis, see `uncertainty_coefficient`. Empty where nothing changes.

    """
    each = np.array(changes, float)
    if each.sum() <= each[..., UNCHANGED].sum():
        return {}
    return min((_by_axis(unit) for unit in each.swapaxes(0, 1)), key=lambda one: max(one.values()))


def _by_axis(counts: np.ndarray) -> dict[str, float]:
    # Counts are (R, BINS, CLASSES) of the recordings.
    pooled = counts.sum(axis=0)
    edge = AXES['edge']
    at_edges = pooled[edge.start : edge.start + edge.bins].sum(axis=0)
    of_recordings = uncertainty_coefficient(counts[:, _ALL])
    return {
        'recording': of_recordings,
        'uptime': of_recordings,  # recordings sorted by it tell at most as much
        'edge': uncertainty_coefficient(np.array([pooled[_ALL], at_edges])),
        **{
            name: uncertainty_coefficient(pooled[axis.start : axis.start + axis.bins])
            for name, axis in AXES.items()
            if name in _ALONG
        },
    }


def uncertainty_coefficient(counts: np.ndarray) -> float:
    """
    Return the fraction of the entropy of a class that the bin takes away: Theil's U.

    Parameters
    ----------
    counts : numpy.ndarray
        (bins, classes) how often each class is in each bin.

    Returns
    -------
    float
        From 0 to 1; near 0 where almost all are in one class.

    """
    total = counts.sum()
    if not total:
        return 0.0
    entropy = float(stats.entropy(counts.sum(axis=0)))
    of_bin = counts.sum(axis=1)
    within = np.array([stats.entropy(row) for row in counts[of_bin > 0]])
    taken = entropy - float(within @ of_bin[of_bin > 0]) / total
    return taken / (entropy + WHERE.least_entropy)

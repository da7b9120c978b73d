"""The covariates along which a gap is looked for, and their bins."""

from dataclasses import dataclass
from functools import lru_cache

from flexx2_sim_ros.gap.calibration.data import BINNING
from flexx2_sim_ros.physics.frame_state import SPEED_OF_LIGHT
from flexx2_sim_ros.profiles.modes import Profile
import numpy as np

TILE_ROWS, TILE_COLUMNS = BINNING.tiles


@dataclass(frozen=True)
class Axis:
    """
    One covariate and its bins.

    `edges` are limits between bins, one fewer than bins; empty if the bins are classes, and in
    `AXES` if the edges depend on the camera. `start` is the index of its first bin among those of
    all axes. `full`: all channels are measured along it; otherwise only bias and invalid pixels.
    """

    name: str
    unit: str
    edges: tuple[float, ...]
    bins: int
    start: int
    full: bool


Axes = dict[str, Axis]


def _axes(distances: tuple[float, ...], fine: tuple[float, ...]) -> Axes:
    first, step, number = BINNING.amplitudes
    table: list[tuple[str, str, tuple[float, ...], int, bool]] = [
        ('all', '', (), 1, True),
        ('distance', 'm', distances, BINNING.distance_edges + 1, True),
        ('incidence', 'deg', BINNING.incidences, 9, True),
        ('radius', '', BINNING.radii, 6, True),
        ('region', '', (), 12, True),
        ('edge', '', (), 16, True),
        (
            'log_amplitude',
            'ln 1/m^2',
            tuple(first + step * i for i in range(number)),
            number + 1,
            True,
        ),
        ('concavity', '', BINNING.concavities, 6, True),
        ('speed', 'm/s', BINNING.speeds, 9, True),
        ('beyond', '', (), 2, False),
        ('fine_distance', 'm', fine, BINNING.fine_bins, False),
        ('tile', '', (), TILE_ROWS * TILE_COLUMNS, False),
    ]
    axes, start = {}, 0
    for name, unit, edges, bins, full in table:
        axes[name] = Axis(name, unit, edges, bins, start, full)
        start += bins
    return axes


# The names and the numbers of bins are the same for all cameras.
AXES = _axes((), ())
# Axes that sort all pixels with a distance, also those at edges and out of range.
ENDLESS = (
    'all',
    'distance',
    'incidence',
    'radius',
    'region',
    'log_amplitude',
    'fine_distance',
    'edge',
    'speed',
)
BINS = sum(axis.bins for axis in AXES.values())


def axes_of(camera: Profile) -> Axes:
    """
    Return the axes with the bins of a camera.

    Its range over all modes gives the bins of ``distance``. Its highest modulation frequency gives
    those of ``fine_distance``, or its range if it has no modulation frequency.
    """
    return _axes_between(
        min(mode.range_min for mode in camera.modes),
        max(mode.range_max for mode in camera.modes),
        max(camera.modulation_hz, default=0.0),
    )


@lru_cache(maxsize=8)
def _axes_between(nearest: float, farthest: float, frequency: float) -> Axes:
    last = BINNING.farthest_share * farthest
    first = min(max(BINNING.nearest_share * nearest, last / BINNING.span), 0.9 * last)
    log = tuple(float(x) for x in np.round(np.geomspace(first, last, BINNING.distance_edges), 3))
    step = (
        SPEED_OF_LIGHT / (2 * frequency) / BINNING.fine_a_period
        if frequency
        else last / BINNING.fine_bins
    )
    step = max(round(step, 2), 0.01)
    return _axes(log, tuple(step * i for i in range(1, BINNING.fine_bins)))

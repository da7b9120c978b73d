"""Figures of a report: curves along covariates."""

from collections.abc import Sequence

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.axes import AXES, Axes, Axis
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.features import LAYOUT, likeness
from flexx2_sim_ros.gap.report.text import spaced
from flexx2_sim_ros.html_drawing import curves
import numpy as np

# Label of each channel, and the factor to its unit.
_LABELS = {
    'bias': ('depth error, sigma_z', 1.0),
    'log_variance': ('noise variance, ln', 1.0),
    'invalid': ('invalid pixels, %', 100.0),
    'high': ('outliers behind, %', 100.0),
    'low': ('outliers in front, %', 100.0),
    'kurtosis': ('tails of the noise (kurtosis)', 1.0),
    'lag': ('correlation with frame before', 1.0),
    'neighbour': ('correlation of neighbours', 1.0),
}
_ALONG = (
    'distance',
    'incidence',
    'log_amplitude',
    'fine_distance',
    'radius',
    'speed',
    'concavity',
    'edge',
)
# Labels of axes whose name and unit do not say what they are.
_TITLES = {
    'edge': 'pixels from a depth jump (negative: near side)',
    'log_amplitude': 'ln amplitude (0: a white wall at 1 m)',
    'radius': 'distance from the image centre / half-diagonal',
    'concavity': 'concavity (positive: corners, negative: edges)',
    'fine_distance': 'distance [m]',
}
_CHARTS, _OF_ONE_CHANNEL = 4, 2
_FEWEST = 500  # least number of pixels for a point of a curve
# The 16 edge bins (direction, side, distance) without their direction: four bins.
_FROM_EDGE = {-2.0: 1, -1.0: 0, 1.0: 2, 2.0: 3}
_FIRST = {(f.channel, f.axis): i for i, f in reversed(list(enumerate(LAYOUT)))}


def charts(confirmed: Sequence[Outcome], explained: bool, axes: Axes) -> html.Html:
    """
    Return curves of real and simulated depth along the covariates that show the gap best, as HTML.

    If the diagnosis has effects (`explained`), curves with them are drawn, too.
    """
    found = []
    for name in _ALONG:
        for channel in _LABELS:
            if (channel, name) in _FIRST:
                lines = _lines(confirmed, channel, AXES[name])
                if np.isfinite(lines[0]).sum() >= 3:
                    found.append((_importance(lines, channel), channel, name, lines))
    found.sort(key=lambda item: -item[0])
    chosen: list[tuple[str, str, np.ndarray]] = []
    for _, channel, name, lines in found:
        if sum(other == channel for other, *_ in chosen) < _OF_ONE_CHANNEL:
            chosen.append((channel, name, lines))
    names = ['real', 'simulated'] + (['with the effects'] if explained else [])
    figures = []
    for channel, name, lines in chosen[:_CHARTS]:
        label, factor = _LABELS[channel]
        axis = axes[name]
        unit = f' [{axis.unit}]' if axis.unit else ''
        title = _TITLES.get(name, spaced(name) + unit)
        figures.append(
            curves(
                _middles(axis),
                lines[: len(names)],
                names,
                title,
                label,
                6 * FEATURES.tolerances[channel] * factor,
            )
        )
    return html.join(
        html.heading('Real against simulated'),
        html.beside(*figures),
        html.note(
            'Mean over the pixels of all recordings, for the curves that differ most. sigma_z is '
            'the noise that the simulation gives a pixel. The noise variance is relative to it '
            '(ln 1 = 0: equal).'
        ),
    )


def _lines(confirmed: Sequence[Outcome], channel: str, axis: Axis) -> np.ndarray:
    # Real, without and with the effects, mean over pixels; NaN where there are too few.
    first = _FIRST[channel, axis.name]
    values = np.array([one.seen[:, first : first + axis.bins] for one in confirmed], float)
    pixels = np.array(
        [one.counts[axis.start : axis.start + axis.bins] for one in confirmed], float
    )
    weights = np.where(np.isfinite(values), pixels[:, None], 0.0)
    total, summed = weights.sum(axis=0), (np.nan_to_num(values) * weights).sum(axis=0)
    if axis.name == 'edge':
        total, summed = (
            one.reshape(3, 4, 4).sum(axis=1)[:, list(_FROM_EDGE.values())]
            for one in (total, summed)
        )
    lines = np.where(total >= _FEWEST, _LABELS[channel][1] * summed / np.maximum(total, 1), np.nan)
    return likeness(lines) if channel == 'lag' else lines


def _importance(lines: np.ndarray, channel: str) -> float:
    # RMS difference between recording and simulation, in units of the tolerance.
    difference = lines[0] - lines[1]
    good = np.isfinite(difference)
    if not good.any():
        return 0.0
    matters = FEATURES.tolerances[channel] * _LABELS[channel][1]
    return float(np.sqrt(np.square(difference[good]).mean())) / matters


def _middles(axis: Axis) -> np.ndarray:
    if axis.name == 'edge':
        return np.array(list(_FROM_EDGE))
    low, high = 2 * axis.edges[0] - axis.edges[1], 2 * axis.edges[-1] - axis.edges[-2]
    ends = np.array([low, *axis.edges, high])
    return np.asarray((ends[1:] + ends[:-1]) / 2)

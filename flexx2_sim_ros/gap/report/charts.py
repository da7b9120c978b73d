"""Figures of a report: maps of the image, and curves along covariates."""

from collections.abc import Sequence

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.axes import AXES, Axis, TILE_COLUMNS, TILE_ROWS
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import LAYOUT, likeness
from flexx2_sim_ros.gap.report.text import spaced
from flexx2_sim_ros.html_drawing import curves, picture
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
_IN_MM = ('bias', 'distance'), ('log_variance', 'distance')  # charts of their own
_NINETY = 1.645  # standard deviations, two-sided
_CHARTS, _OF_ONE_CHANNEL = 4, 2
_FEWEST = 500  # least number of pixels for a point of a curve
_LIMIT = 15  # end of the colour scale of a map, in units of the tolerance
# The 16 edge bins (direction, side, distance) without their direction: four bins.
_FROM_EDGE = {-2.0: 1, -1.0: 0, 1.0: 2, 2.0: 3}
_FIRST = {(f.channel, f.axis): i for i, f in reversed(list(enumerate(LAYOUT)))}


def maps(confirmed: Sequence[Outcome], explained: bool) -> html.Html:
    """
    Return maps of the mean depth error, and of the channel that differs most otherwise, as HTML.

    If the diagnosis has effects (`explained`), images with them are drawn, too.
    """
    pairs = [(1, 'before', 'real minus simulated')]
    if explained:
        pairs.append((2, 'after', 'real minus simulated, with the effects'))
    size = confirmed[0].maps['real'].shape
    some = [one.maps for one in confirmed if one.maps['real'].shape == size]
    figures = []
    for _, name, text in pairs:
        difference = np.array([one['real'].astype(np.float32) - one[name] for one in some])
        good = np.isfinite(difference)
        mean = np.where(good, difference, 0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
        mean[~good.any(axis=0)] = np.nan
        figures.append(_map(mean, 1.5, f'{text}: mean depth error', 'sigma_z'))
    channel, size_there = max(
        (
            (name, _importance(_lines(confirmed, name, AXES['region']), name))
            for name in _LABELS
            if name != 'bias'
        ),
        key=lambda item: item[1],
    )
    if size_there > 1:
        lines = _lines(confirmed, channel, axis := AXES['region'])
        if (channel, 'tile') in _FIRST:
            fine = _lines(confirmed, channel, AXES['tile'])
            if np.isfinite(fine).any():  # Tiles of small images have too few pixels.
                axis, lines = AXES['tile'], fine
        label, factor = _LABELS[channel]
        limit = _LIMIT * FEATURES.tolerances[channel] * factor
        for i, _, text in pairs:
            rows, columns = (TILE_ROWS, TILE_COLUMNS) if axis.name == 'tile' else (3, 4)
            image = (lines[0] - lines[i]).reshape(rows, columns)
            image = image.repeat(44 // rows, axis=0).repeat(56 // columns, axis=1)
            figures.append(
                _map(image, limit, f'{text}: {label.partition(",")[0]}', label.partition(', ')[2])
            )
    return html.folded('Errors on the image', html.beside(*figures))


def _map(image: np.ndarray, limit: float, text: str, unit: str) -> html.Html:
    ends = f'blue {-limit:.2g} to red {limit:+.2g} {unit}'.strip()
    caption = f'{text}, {ends}; white: no difference, gray: not seen'
    return html.figure(picture(image, limit), caption, text, 420)


def charts(
    evidence: Sequence[Evidence], confirmed: Sequence[Outcome], explained: bool
) -> html.Html:
    """
    Return curves of real and simulated depth, as HTML: bias, scatter, and what shows the gap best.

    If the diagnosis has effects (`explained`), curves with them are drawn, too.
    """
    axes, found = evidence[0].axes, []
    for name in _ALONG:
        for channel in _LABELS:
            if (channel, name) in _FIRST and (channel, name) not in _IN_MM:
                lines = _lines(confirmed, channel, AXES[name])
                if np.isfinite(lines[0]).sum() >= 3:
                    found.append((_importance(lines, channel), channel, name, lines))
    found.sort(key=lambda item: -item[0])
    chosen: list[tuple[str, str, np.ndarray]] = []
    for _, channel, name, lines in found:
        if sum(other == channel for other, *_ in chosen) < _OF_ONE_CHANNEL:
            chosen.append((channel, name, lines))
    names = ['real', 'simulated'] + (['with the effects'] if explained else [])
    figures = _in_millimetres(evidence, confirmed, names)
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
    return html.folded(
        'Bias and scatter along distance, and other errors',
        html.beside(*figures),
        html.note(
            'Mean over the pixels of all recordings: bias and scatter (standard deviation over '
            'time), and the curves that differ most. Band: how well the ground truth is known '
            '(90 %), if the recordings say it. sigma_z is the noise that the simulation gives a '
            'pixel. The noise variance is relative to it (ln 1 = 0: equal).'
        ),
    )


def _in_millimetres(
    evidence: Sequence[Evidence], confirmed: Sequence[Outcome], names: Sequence[str]
) -> list[html.Html]:
    # Bias and scatter over distance.
    axis = AXES['distance']
    places = slice(axis.start, axis.start + axis.bins)
    sigma = 1000 * np.nan_to_num([one.sigma[places] for one in evidence])
    sigma = sigma.sum(axis=0) / np.maximum((sigma > 0).sum(axis=0), 1)
    bias, noise = (_lines(confirmed, channel, axis)[: len(names)] for channel, _ in _IN_MM)
    bias[:, ~np.isfinite(bias[0])] = np.nan
    truths = (one.accuracy for one in evidence)
    known = [[one.sigma or 0.0, one.pose or 0.0, one.offset or 0.0] for one in truths]
    wide = 1000 * _NINETY * float(np.sqrt(np.square(known).sum(axis=1).mean()))
    band = sigma * bias[0] + wide * np.array([[-1], [1]]) if wide else None
    drawn = (sigma * bias, 'bias, mm', band), (sigma * np.exp(noise / 2), 'scatter, mm', None)
    return [
        curves(
            _middles(evidence[0].axes[axis.name]),
            lines,
            names,
            'distance [m]',
            label,
            1.0,
            band=own,
        )
        for lines, label, own in drawn
        if np.isfinite(lines[0]).sum() >= 3  # Single frames show no scatter.
    ]


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
    fewest = 1 if axis.name == 'tile' else _FEWEST
    lines = np.where(total >= fewest, _LABELS[channel][1] * summed / np.maximum(total, 1), np.nan)
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

"""Figures of a report: maps of the image, curves along covariates, and the forms of effects."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.effects import loadable
from flexx2_sim_ros.effects.tables import Curve, PixelMap
from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.axes import AXES, Axis, TILE_COLUMNS, TILE_ROWS
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import LAYOUT, likeness
from flexx2_sim_ros.gap.forms.bias import covariate_of
from flexx2_sim_ros.gap.forms.binned import KINDS, NOISE, pooled
from flexx2_sim_ros.gap.forms.looked import Looked
from flexx2_sim_ros.gap.forms.proposals import DEAD, FormProposal, FormVerdict
from flexx2_sim_ros.gap.report.text import short, spaced
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
# Labels of axes whose name and unit do not say what they are.
_TITLES = {
    'log_amplitude': 'ln amplitude (0: a white wall at 1 m)',
    'fine_distance': 'distance [m]',
    'radius': 'distance from the image centre / half-diagonal',
    'speed': 'speed [m/s]',
    'concavity': 'concavity (positive: corners, negative: edges)',
    'edge': 'pixels from a depth jump (negative: near side)',
}
_ALONG = 'distance', 'incidence', *_TITLES
_IN_MM = ('bias', 'distance'), ('log_variance', 'distance')  # charts of their own
_NINETY = 1.645  # standard deviations, two-sided
_CHARTS, _OF_ONE_CHANNEL = 4, 2
_FEWEST = 500  # least number of pixels for a point of a curve
_LIMIT = 15  # end of the colour scale of a map, in units of the tolerance
_WIDE = 420  # of a map, in pixels
# The 16 edge bins (direction, side, distance) without their direction: four bins.
_FROM_EDGE = {-2.0: 1, -1.0: 0, 1.0: 2, 2.0: 3}
_FIRST = {(f.channel, f.axis): i for i, f in reversed(list(enumerate(LAYOUT)))}
_POINTS = 60  # of the curve of a bias in the form of the catalogue
# On the values of a curve, and what they are then; a bias if it is not said.
_UNITS = {**dict.fromkeys(KINDS, (100.0, 'invalid, %')), NOISE: (1.0, 'factor on sigma_z')}


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
        difference = [one['real'].astype(np.float32) - one[name] for one in some]
        mean = np.ma.masked_invalid(difference).mean(axis=0).filled(np.nan)
        figures.append(_map(mean, 1.5, f'{text}: mean depth error', 'sigma_z'))
    axis = AXES['region']
    others = {name: _lines(confirmed, name, axis) for name in _LABELS if name != 'bias'}
    channel = max(others, key=lambda name: _importance(others[name], name))
    lines = others[channel]
    if _importance(lines, channel) > 1:
        rows, columns = 3, 4
        if (channel, 'tile') in _FIRST:
            fine = _lines(confirmed, channel, AXES['tile'])
            if np.isfinite(fine).any():  # Tiles of small images have too few pixels.
                lines, rows, columns = fine, TILE_ROWS, TILE_COLUMNS
        label, factor = _LABELS[channel]
        what, _, unit = label.partition(', ')
        limit = _LIMIT * FEATURES.tolerances[channel] * factor
        for i, _, text in pairs:
            image = (lines[0] - lines[i]).reshape(rows, columns)
            image = image.repeat(44 // rows, axis=0).repeat(56 // columns, axis=1)
            figures.append(_map(image, limit, f'{text}: {what}', unit))
    return html.folded('Errors on the image', html.beside(*figures))


def _map(image: np.ndarray, limit: float, text: str, unit: str) -> html.Html:
    ends = f'blue {-limit:.2g} to red {limit:+.2g} {unit}'.strip()
    caption = f'{text}, {ends}; white: no difference, gray: not seen'
    return html.figure(picture(image, limit), caption, text, _WIDE)


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
        unit = f' [{axes[name].unit}]' if axes[name].unit else ''
        title = _TITLES.get(name, spaced(name) + unit)
        least = 6 * FEATURES.tolerances[channel] * factor
        x = _middles(axes[name])
        figures.append(curves(x, lines[: len(names)], names, title, label, least))
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
    axis, x = AXES['distance'], _middles(evidence[0].axes['distance'])
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
        curves(x, lines, names, 'distance [m]', label, 1.0, band=own)
        for lines, label, own in drawn
        if np.isfinite(lines[0]).sum() >= 3  # Single frames show no scatter.
    ]


def _lines(confirmed: Sequence[Outcome], channel: str, axis: Axis) -> np.ndarray:
    # Real, without and with the effects, mean over pixels; NaN where there are too few.
    first, bins = _FIRST[channel, axis.name], slice(axis.start, axis.start + axis.bins)
    values = np.array([one.seen[:, first : first + axis.bins] for one in confirmed], float)
    pixels = np.array([one.counts[bins] for one in confirmed], float)
    weights = np.where(np.isfinite(values), pixels[:, None], 0.0)
    total, summed = weights.sum(axis=0), (np.nan_to_num(values) * weights).sum(axis=0)
    if axis.name == 'edge':
        order = list(_FROM_EDGE.values())
        total, summed = (one.reshape(3, 4, 4).sum(axis=1)[:, order] for one in (total, summed))
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


def forms(verdicts: Sequence[FormVerdict], looked: Sequence[Looked]) -> html.Html:
    """Return the curves, maps and numbers of forms that were taken, as HTML."""
    return html.folded(
        'Curves and maps that were fitted',
        html.beside(*(_form(one.proposal, looked) for one in verdicts)),
        html.note(
            'What was fitted to the recordings. Bands: 90 % intervals over recordings '
            '(jackknife). Dashed: in the form of the catalogue.'
        ),
    )


def _form(one: FormProposal, looked: Sequence[Looked]) -> html.Html:
    effect = spaced(one.effect)
    for field, form in one.together.items():
        if isinstance(form, PixelMap):
            if one.effect == DEAD:
                limit, factor, text = 1.0, 1.0, 'red is always lost, white never'
            else:
                limit, factor = 1000 * float(np.quantile(np.abs(form.values), 0.98)) or 1.0, 1000
                text = f'blue {-limit:.2g} to red {limit:+.2g} mm'
            drawn = picture(factor * form.values, limit)
            return html.figure(drawn, f'{effect}: {text}', width=_WIDE)
        if isinstance(form, Curve):
            over = loadable()[one.effect].tables()[field].over
            x, typical = _typical(one.effect, field, looked)
            factor, unit = _UNITS.get(one.effect, (1000.0, 'along the ray, mm'))
            middle = form.at(x)
            wide = _NINETY * _error(np.array([own[field].at(x) for own in one.without], float))
            return curves(
                x,
                factor * np.array([typical, middle]),
                ('form of the catalogue', 'as fitted'),
                over,
                f'{effect}: {unit}',
                0.5,
                kinds=('simulated', 'effects'),
                band=factor * np.array([middle - wide, middle + wide]),
            )
    # Each fitted parameter, with its standard error over recordings.
    rows = [
        (name, short(value, 4), short(_error(np.array([own[name] for own in one.without]))))
        for name, value in one.together.items()
        if name != 'strength'
    ]
    table = html.table([effect, 'as fitted', 'standard error'], rows)
    return html.element('figure', table, html.element('figcaption', one.label))


def _error(each: np.ndarray) -> Any:
    # Standard error over recordings, by the jackknife; (R, ...) fitted without each of them.
    return np.sqrt(len(each) - 1) * each.std(axis=0)


def _typical(effect: str, field: str, looked: Sequence[Looked]) -> tuple[np.ndarray, np.ndarray]:
    # Places along the covariate, and what the effect as diagnosed is there: of a bias the mean
    # change of the range, in bins of its covariate.
    for kind in KINDS.get(effect, ()):
        if kind.field == field:
            known = pooled([one.binned[effect] for one in looked]).weight[kind.over] > 0
            typical = pooled([one.typical[effect] for one in looked]).mean(kind.over)
            return kind.middles[known], typical[known]
    values = np.concatenate([getattr(one.samples, covariate_of(effect)) for one in looked])
    shift = np.concatenate([one.shifts[effect] * one.samples.length for one in looked])
    low, high = np.quantile(values, (0.005, 0.995))
    edges = np.linspace(low, high, _POINTS + 1)
    place = np.digitize(values, edges) - 1
    inside = (place >= 0) & (place < _POINTS)
    total = np.bincount(place[inside], shift[inside], minlength=_POINTS)
    count = np.bincount(place[inside], minlength=_POINTS)
    with np.errstate(invalid='ignore', divide='ignore'):
        return (edges[1:] + edges[:-1]) / 2, total / count

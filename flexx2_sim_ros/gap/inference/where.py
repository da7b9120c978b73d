"""Where the real camera and the simulation differ."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import AXES, Axes
from flexx2_sim_ros.gap.features.features import (
    CHANNEL_UNITS,
    LAYOUT,
    likeness,
    STRUCTURE_UNITS,
    TOLERANCE,
)
from flexx2_sim_ros.gap.features.pixel_groups import GROUP_CHANNELS, GROUP_TOLERANCE, PixelGroups
from flexx2_sim_ros.gap.inference.cover import cover, WhereCondition
from flexx2_sim_ros.gap.inference.main_covariate import main_covariate, MainCovariate
from flexx2_sim_ros.gap.inference.model import Model
import numpy as np
from scipy import stats

_BESIDES = ('concavity', 'speed')  # listed in addition, where they show more
_ALWAYS = ('edge', 'beyond', 'structure')  # are not about surfaces
_EDGE = [
    f'{side} side of a jump {where}, {near}'
    for where in ('to the right', 'to the left', 'below', 'above')
    for side in ('near', 'far')
    for near in ('next to it', '2 to 3 px away')
]
# Groups of surface pixels do not contain these: listed beside the conditions on pixels.
_BESIDE = ('structure', 'nothing there', 'beyond the range', *_BESIDES)
_AT_EDGES = np.array([f.axis == 'edge' for f in LAYOUT])
_IN_SIGMA = np.array(
    [f.axis != 'structure' and CHANNEL_UNITS[f.channel] == 'sigma' for f in LAYOUT]
)
_BINS = np.array([0 if f.axis == 'structure' else AXES[f.axis].start + f.place for f in LAYOUT])
_INDEX = {(f.channel, f.axis, f.place): i for i, f in enumerate(LAYOUT)}


def places(
    model: Model,
    difference: np.ndarray,
    shown: np.ndarray,
    groups: Sequence[PixelGroups],
    tells: Mapping[str, float],
    exact: bool,
    sigma_error: float,
    named: Collection[type[Effect]],
) -> list[dict[str, Any]]:
    """
    List where real and simulated differ by more than what matters.

    Parameters
    ----------
    model : Model
        The recordings.
    difference : numpy.ndarray
        (R, SIZE) real minus simulated features, or the change by the effects if they explain it.
    shown : numpy.ndarray
        (R, SIZE) real minus simulated features, from which the listed sizes come.
    groups : sequence of PixelGroups
        One for each recording, from the simulation with the effects found.
    tells : mapping of str to float
        How much each covariate tells about what these effects change, see `told`.
    exact : bool
        Whether effects explain the difference. Then their change is listed, which has no noise.
    sigma_error : float
        Fraction by which sigma_z was found to be wrong.
    named : collection of type of Effect
        The effects that explain the difference or a part of it.

    Returns
    -------
    list of dict
        First the covariate that the difference depends on most, see `main_covariate`. Then
        conditions that select the pixels that differ, see `cover`, and the rows of `cells` that
        are not about surface pixels. All rows of `cells` where pixels are too few to be grouped.

    """
    rows = _all_places(model, difference, shown, groups, exact, sigma_error)
    main = main_covariate(model, difference, shown, exact, named, tells)
    if main is None:
        return rows
    first = _main_row(main, model)
    same = ('covariate', 'low', 'high', 'detail', 'channel')
    return [first, *(row for row in rows if any(row[key] != first[key] for key in same))]


def _main_row(main: MainCovariate, model: Model) -> dict[str, Any]:
    names, axes = [e.name for e in model.evidence], model.evidence[0].axes
    unit = {**CHANNEL_UNITS, **STRUCTURE_UNITS}[main.channel]
    tolerance = FEATURES.tolerances[main.channel]
    p = _tail(np.array([main.difference]), tolerance, np.array([main.noise**2]))
    return {
        **_interval(axes, names, main.axis, main.first, main.last),
        'channel': main.channel,
        'size': float(likeness(main.size)) if main.channel == 'lag' else main.size,
        'unit_size': 'mm' if unit == 'sigma' else unit,
        'q_value': float(p[0]),
    }


def _interval(
    axes: Axes, names: Sequence[str], axis: str, first: int, last: int
) -> dict[str, Any]:
    if axis == 'uptime':
        edges = (None, *WHERE.uptimes, None)
        return {
            'covariate': axis,
            'low': edges[first],
            'high': edges[last + 1],
            'unit': 's',
            'detail': '',
        }
    cell = _bounds(axes, axis, first, last)
    if axis == 'recording':
        cell.update(low=first, high=first, detail=names[first])
    return cell


def _all_places(
    model: Model,
    difference: np.ndarray,
    shown: np.ndarray,
    groups: Sequence[PixelGroups],
    exact: bool,
    sigma_error: float,
) -> list[dict[str, Any]]:
    # Rows of `cover` and `cells`, the largest difference first.
    binned = cells(model, difference, exact, shown)
    conditions = cover(groups, not exact, sigma_error)
    if not conditions:
        return [row for _, row in binned]
    names, axes = [e.name for e in model.evidence], model.evidence[0].axes
    rows = [row for one in conditions for row in _rows(one, names, axes)]
    q = stats.false_discovery_control(np.array([row['q_value'] for _, row in rows]))
    for (_, row), value in zip(rows, q, strict=True):
        row['q_value'] = float(value)
    rows += [item for item in binned if item[1]['covariate'] in _BESIDE]
    return [row for _, row in sorted(rows, key=lambda item: -item[0])]


def _rows(one: WhereCondition, names: list[str], axes: Axes) -> list[tuple[float, dict[str, Any]]]:
    # One row for each channel that differs, with the difference as a multiple of its tolerance.
    ratio = np.abs(one.difference) / GROUP_TOLERANCE
    p = _tail(one.difference, GROUP_TOLERANCE, one.noise**2)
    out = []
    cell = _interval(axes, names, one.axis, one.first, one.last)
    for k in np.flatnonzero(ratio >= min(1.0, float(ratio.max()))):
        size, unit = float(one.size[k]), CHANNEL_UNITS[GROUP_CHANNELS[k]]
        if unit == 'sigma':
            size, unit = one.bias * 1000, 'mm'
        out.append(
            (
                float(ratio[k]),
                {
                    **cell,
                    'channel': GROUP_CHANNELS[k],
                    'size': size,
                    'unit_size': unit,
                    'q_value': float(p[k]),
                },
            )
        )
    return out


def cells(
    model: Model, difference: np.ndarray, exact: bool = False, shown: np.ndarray | None = None
) -> list[tuple[float, dict[str, Any]]]:
    """
    List the bins in which real and simulated differ by more than the tolerance.

    Parameters
    ----------
    model : Model
        The recordings.
    difference : numpy.ndarray
        (R, SIZE) real minus simulated features.
    exact : bool
        Whether the difference has no noise, as the change by effects. The places of edges are
        never known exactly.
    shown : numpy.ndarray, optional
        (R, SIZE) from which the listed sizes come; ``difference`` when left out.

    Returns
    -------
    list of tuple
        The difference as a multiple of the tolerance, largest first; and a dict of ``covariate,
        low, high, unit, channel, size, unit_size, q_value, detail``.

    """
    count = model.good.sum(axis=0)
    each = np.where(model.good, difference, 0)
    # Variance that noise, and edges known to a pixel only, leave in these recordings.
    uncertain = model.good & (_AT_EDGES | (not exact))
    own = np.where(uncertain, model.scale2 - np.square(TOLERANCE), 0)
    with np.errstate(invalid='ignore', divide='ignore'):
        mean, variance = each.sum(axis=0) / count, own.sum(axis=0) / count**2
    usable = count > 0
    q = np.ones(len(mean))
    if usable.any():
        p = _tail(mean[usable], TOLERANCE[usable], variance[usable])
        q[usable] = stats.false_discovery_control(p)
    significant = usable & (q < WHERE.false_discoveries)
    weights = np.sum([e.counts for e in model.evidence], axis=0)
    found: list[tuple[float, dict[str, Any]]] = []
    axes = model.evidence[0].axes
    physical, gross = _in_units(model, difference if shown is None else shown), False
    with np.errstate(invalid='ignore', divide='ignore'):
        sizes = physical.sum(axis=0) / count
    for channel in CHANNEL_UNITS:
        best, *others = _axes_to_list(
            model, channel, np.where(usable, mean, 0), variance, weights, each, own
        )
        index = [i for i in _indices(channel, best) if significant[i]]
        if best == 'recording':
            found += _recordings(model, channel, each, own, physical)
        elif sum(weights[_BINS[i]] for i in index) > WHERE.all_over * weights[0]:
            index, others = _indices(channel, 'all'), []
        if channel == 'kurtosis' and gross:
            continue  # Gross errors change the kurtosis wherever they are.
        gross |= channel in ('high', 'low') and bool(index)
        for name in others:
            index += _along(channel, name, significant, weights)
        found += [
            (abs(mean[i]) / TOLERANCE[i], _cell(axes, i, float(sizes[i]), float(q[i])))
            for i in index
        ]
    for name in STRUCTURE_UNITS:
        i = _INDEX[name, 'structure', 0]
        if significant[i]:
            found.append(
                (abs(mean[i]) / TOLERANCE[i], _cell(axes, i, float(sizes[i]), float(q[i])))
            )
    found.sort(key=lambda item: -item[0])
    return found[: WHERE.most]


def _along(channel: str, name: str, significant: np.ndarray, weights: np.ndarray) -> list[int]:
    # Features that differ along another axis. If most pixels along it differ, the axis does not
    # say where the difference is, and none is listed.
    index = _indices(channel, name)
    some = [i for i in index if significant[i]]
    selective = weights[_BINS[some]].sum() < WHERE.selective * weights[_BINS[index]].sum()
    return some if name in _ALWAYS or selective else []


def _axes_to_list(
    model: Model,
    channel: str,
    mean: np.ndarray,
    variance: np.ndarray,
    weights: np.ndarray,
    each: np.ndarray,
    own: np.ndarray,
) -> list[str]:
    # The best axis is the one with the largest mean square difference of a channel, averaged over
    # its bins, minus the part that noise causes; then other axes that are listed, too.
    power = {}
    for name in (*WHERE.cuts, *_BESIDES):
        if name == 'recording':
            i = _INDEX[channel, 'all', 0]
            weight = np.array([e.counts[0] for e in model.evidence]) * model.good[:, i]
            square = each[:, i] ** 2 - own[:, i]
        else:
            index = _indices(channel, name)
            if not index:
                continue
            axis = AXES[name]
            weight = weights[axis.start : axis.start + axis.bins]
            square = mean[index] ** 2 - np.nan_to_num(variance[index], posinf=0.0)
        power[name] = float((weight * square).sum() / max(weight.sum(), 1.0))
    best = max(WHERE.cuts, key=lambda name: WHERE.cuts[name] * power.get(name, -np.inf))
    return [
        best,
        *(name for name in _BESIDES if power.get(name, 0.0) > WHERE.besides * power[best]),
        *(name for name in _ALWAYS if _indices(channel, name)),
    ]


def _indices(channel: str, axis: str) -> list[int]:
    bins = AXES[axis].bins if axis in AXES else 0
    return [_INDEX[channel, axis, i] for i in range(bins) if (channel, axis, i) in _INDEX]


def _in_units(model: Model, shown: np.ndarray) -> np.ndarray:
    # (R, SIZE) differences, in mm where they are in sigma, by each recording's own sigma_z.
    sigma = np.nan_to_num([e.sigma for e in model.evidence], posinf=0.0)
    return np.where(model.good, shown, 0) * np.where(_IN_SIGMA, 1000 * sigma[:, _BINS], 1.0)


def _recordings(
    model: Model, channel: str, each: np.ndarray, own: np.ndarray, physical: np.ndarray
) -> list[tuple[float, dict[str, Any]]]:
    i = _INDEX[channel, 'all', 0]
    p = _tail(each[:, i], TOLERANCE[i], own[:, i])
    out = []
    for r, (size, q) in enumerate(zip(each[:, i], stats.false_discovery_control(p), strict=True)):
        if model.good[r, i] and q < WHERE.false_discoveries:
            cell = _cell(model.evidence[r].axes, i, float(physical[r, i]), float(q))
            cell.update(covariate='recording', low=r, high=r, detail=model.evidence[r].name)
            out.append((abs(float(size)) / float(TOLERANCE[i]), cell))
    return out


def _tail(size: np.ndarray, limit: Any, variance: np.ndarray) -> np.ndarray:
    # Probability of a difference this far beyond the tolerance by noise alone.
    beyond = np.maximum(np.abs(size) - limit, 0) / np.sqrt(np.maximum(variance, 1e-12))
    return np.asarray(stats.t.sf(beyond, WHERE.degrees))


def mean_sigma(model: Model) -> np.ndarray:
    """Return the mean sigma_z of each bin, (BINS,) metres; harmonic, 0 where nothing was seen."""
    with np.errstate(invalid='ignore', divide='ignore'):
        inverse = np.array([1 / e.sigma for e in model.evidence])
        good = np.isfinite(inverse)
        mean = np.where(good, inverse, 0).sum(axis=0) / good.sum(axis=0)
        return np.asarray(np.nan_to_num(1 / mean))


def _cell(axes: Axes, index: int, size: float, q: float) -> dict[str, Any]:
    feature = LAYOUT[index]
    out = {
        **_bounds(axes, feature.axis, feature.place, feature.place),
        'channel': feature.channel,
        'size': size,
        'unit_size': '',
        'q_value': q,
    }
    if feature.axis == 'structure':
        out['unit_size'] = STRUCTURE_UNITS[feature.channel]
        return out
    if feature.axis == 'edge':
        out['detail'] = _EDGE[feature.place]
    if feature.channel == 'lag':
        out['size'] = float(likeness(size))
    out['unit_size'] = 'mm' if _IN_SIGMA[index] else CHANNEL_UNITS[feature.channel]
    return out


def _bounds(axes: Axes, name: str, first: int, last: int) -> dict[str, Any]:
    # Columns of a row that describe the bins of an axis from first to last.
    out: dict[str, Any] = {'covariate': name, 'low': None, 'high': None, 'unit': '', 'detail': ''}
    edges = (None, *axes[name].edges, None) if name in axes else ()
    if name == 'log_amplitude':
        low, high = (
            None if edge is None else float(np.exp(edge))
            for edge in (edges[first], edges[last + 1])
        )
        out.update(covariate='amplitude', low=low, high=high, unit='1/m^2')
    elif len(edges) > 2:
        out.update(low=edges[first], high=edges[last + 1], unit=axes[name].unit)
    elif name == 'edge':
        out.update(low=1, high=1)
    elif name == 'region':
        row, column = divmod(first, 4)
        out['covariate'] = f'image region row {row + 1} of 3, column {column + 1} of 4'
    elif name == 'beyond':
        out['covariate'] = ('nothing there', 'beyond the range')[first]
    return out


def unexplained(model: Model, residual: np.ndarray, base: np.ndarray) -> list[dict[str, Any]]:
    """
    Sum the remaining loss of each channel.

    Parameters
    ----------
    model : Model
        The recordings.
    residual, base : numpy.ndarray
        (R, SIZE) remaining difference; (SIZE,) loss by noise alone.

    Returns
    -------
    list of dict
        ``structure`` (the channel), ``loss`` above that of noise, and ``share``, its fraction of
        the whole remaining loss.

    """
    loss = (model.weights * np.log1p(residual**2 / model.scale2)).sum(axis=0) - base
    names = [*CHANNEL_UNITS, *STRUCTURE_UNITS]
    groups = {
        name: sum(float(loss[i]) for i, f in enumerate(LAYOUT) if f.channel == name)
        for name in names
    }
    total = max(sum(v for v in groups.values() if v > 0), 1e-9)
    return [
        {'structure': name, 'loss': value, 'share': value / total}
        for name, value in sorted(groups.items(), key=lambda item: -item[1])
        if value > WHERE.others * total
    ]

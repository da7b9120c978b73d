"""Where the real camera and the simulation differ."""

from collections.abc import Collection, Sequence
from typing import Any

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import Axes
from flexx2_sim_ros.gap.features.features import CHANNEL_UNITS, LAYOUT, STRUCTURE_UNITS, TOLERANCE
from flexx2_sim_ros.gap.features.pixel_groups import GROUP_CHANNELS, GROUP_TOLERANCE, PixelGroups
from flexx2_sim_ros.gap.inference.cover import cover, shows_along, WhereCondition
from flexx2_sim_ros.gap.inference.model import Model
import numpy as np
from scipy import stats

_UNITS = {**CHANNEL_UNITS, **STRUCTURE_UNITS}
# What is not about surfaces, so that groups of their pixels do not contain it.
_BESIDE = [i for i, f in enumerate(LAYOUT) if f.axis in ('structure', 'beyond')]


def places(
    model: Model,
    difference: np.ndarray,
    shown: np.ndarray,
    groups: Sequence[PixelGroups],
    exact: bool,
    sigma_error: float,
    named: Collection[type[Effect]],
) -> list[dict[str, Any]]:
    """
    List where real and simulated differ by more than what matters.

    First are the conditions of the covariate that the difference depends on most, see `cover`;
    then the others, and what differs in whole images and where no surface is. In both parts the
    largest difference is first.

    * `difference`: (R, SIZE) real minus simulated features, or the change by the effects if they
      explain it.
    * `shown`: (R, SIZE) real minus simulated features, from which the listed sizes come.
    * `groups`: one for each recording, from the simulation with the effects found.
    * `exact`: whether effects explain the difference. Then their change is listed, which has no
      noise.
    * `sigma_error`: fraction by which sigma_z was found to be wrong.
    * `named`: the effects that explain the difference or a part of it.
    """
    names, axes = [e.name for e in model.evidence], model.evidence[0].axes
    expected = {axis for one in named for axis in shows_along(one)}
    uptimes = [e.uptime for e in model.evidence]
    conditions = cover(groups, not exact, sigma_error, expected, uptimes)
    first = [one.axis == conditions[0].axis for one in conditions]
    rows = [
        (main, *row)
        for main, one in zip(first, conditions, strict=True)
        for row in _rows(one, names, axes)
    ]
    if rows:
        q = stats.false_discovery_control(np.array([row['q_value'] for *_, row in rows]))
        for (*_, row), value in zip(rows, q, strict=True):
            row['q_value'] = float(value)
    rows += [(False, *row) for row in beside(model, difference, exact, shown)]
    return [row for *_, row in sorted(rows, key=lambda item: (not item[0], -item[1]))]


def _rows(one: WhereCondition, names: list[str], axes: Axes) -> list[tuple[float, dict[str, Any]]]:
    # One row for each channel that differs, with the difference as a multiple of its tolerance.
    ratio = np.abs(one.difference) / GROUP_TOLERANCE
    p = _tail(one.difference, GROUP_TOLERANCE, one.noise**2)
    out = []
    cell = _bounds(axes, one.axis, one.first, one.last)
    if one.axis == 'recording':
        cell.update(low=one.first, high=one.first, detail=names[one.first])
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


def beside(
    model: Model, difference: np.ndarray, exact: bool, shown: np.ndarray
) -> list[tuple[float, dict[str, Any]]]:
    """
    List what differs by more than the tolerance in whole images, and where no surface is.

    `difference` and `shown` are as for `places`. With `exact` the difference has no noise, as the
    change by effects. Each row comes with its difference as a multiple of the tolerance.
    """
    good, tolerance = model.good[:, _BESIDE], TOLERANCE[_BESIDE]
    count = good.sum(axis=0)
    noise = np.where(good & (not exact), model.scale2[:, _BESIDE] - np.square(tolerance), 0)
    mean, size = (
        np.where(good, one[:, _BESIDE], 0).sum(axis=0) / np.maximum(count, 1)
        for one in (difference, shown)
    )
    q = stats.false_discovery_control(
        _tail(mean, tolerance, noise.sum(axis=0) / np.maximum(count, 1) ** 2)
    )
    axes = model.evidence[0].axes
    return [
        (
            abs(mean[k]) / tolerance[k],
            {
                **_bounds(axes, LAYOUT[i].axis, LAYOUT[i].place, LAYOUT[i].place),
                'channel': LAYOUT[i].channel,
                'size': float(size[k]),
                'unit_size': _UNITS[LAYOUT[i].channel],
                'q_value': float(q[k]),
            },
        )
        for k, i in enumerate(_BESIDE)
        if q[k] < WHERE.false_discoveries
    ]


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


def _bounds(axes: Axes, name: str, first: int, last: int) -> dict[str, Any]:
    # Columns of a row that describe the bins of an axis from first to last.
    out: dict[str, Any] = {'covariate': name, 'low': None, 'high': None, 'unit': '', 'detail': ''}
    limits, unit = (axes[name].edges, axes[name].unit) if name in axes else ((), '')
    if name == 'uptime':
        limits, unit = WHERE.uptimes, 's'
    edges = (None, *limits, None)
    if name == 'log_amplitude':
        low, high = (
            None if edge is None else float(np.exp(edge))
            for edge in (edges[first], edges[last + 1])
        )
        out.update(covariate='amplitude', low=low, high=high, unit='1/m^2')
    elif limits:
        out.update(low=edges[first], high=edges[last + 1], unit=unit)
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
    Sum the remaining loss of each channel, the largest first.

    `residual` is the remaining difference, (R, SIZE); `base` the loss by noise alone, (SIZE,). A
    row has ``structure`` (the channel), ``loss`` above that of noise, and ``share``, its fraction
    of the whole remaining loss.
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

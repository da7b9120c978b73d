"""Where the real camera and the simulation differ."""

from typing import Any

from flexx2_sim_ros.gap.covariates import AXES
from flexx2_sim_ros.gap.features import CHANNELS, LAYOUT, STRUCTURES, TOLERANCE
from flexx2_sim_ros.gap.model import Model
from flexx2_sim_ros.gap.student import q_values, t_tail
import numpy as np

_MOST = 60
_LEAST = 3  # recordings
_SINGLE = np.array([f.axis != 'tile' for f in LAYOUT])
_EDGE = [f'{side} side of a jump {where}, {near}'
         for where in ('to the right', 'to the left', 'below', 'above')
         for side in ('near', 'far') for near in ('next to it', '2 to 3 px away')]


def cells(model: Model, residual: np.ndarray) -> list[dict[str, Any]]:
    """
    List the bins in which what is left of the gap exceeds what matters.

    Parameters
    ----------
    model : Model
        The recordings.
    residual : numpy.ndarray
        (R, SIZE) real less simulated features.

    Returns
    -------
    list of dict
        ``covariate, low, high, unit, channel, size, unit_size, q_value``, largest (in units of
        what matters) first.

    """
    count = model.good.sum(axis=0)
    total = np.where(model.good, residual, 0)
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = total.sum(axis=0) / count
        spread = np.where(model.good, residual - mean, 0)
        noise = np.mean([np.nan_to_num(e.noise, posinf=0.0) for e in model.evidence], axis=0)
        error = np.sqrt(np.maximum(np.square(spread).sum(axis=0) / np.maximum(count - 1, 1),
                                   noise) / count + 1e-12)
        t = np.maximum(np.abs(mean) - TOLERANCE, 0) / error
    usable = _SINGLE & (count >= min(_LEAST, len(residual))) & np.isfinite(t)
    if not usable.any():
        return []
    p = np.full(len(t), 1.0)
    degrees = max(int(np.median(count[usable])) - 1, 1)
    p[usable] = t_tail(t[usable], degrees)
    q = np.ones(len(t))
    q[usable] = q_values(p[usable])
    found = [i for i in np.argsort(-np.abs(mean) / TOLERANCE) if usable[i] and q[i] < 0.1]
    sums = np.nansum([e.sigma for e in model.evidence], axis=0)
    seen = np.sum([np.isfinite(e.sigma) for e in model.evidence], axis=0)
    sigma = sums / np.maximum(seen, 1)
    return [_cell(i, float(mean[i]), float(q[i]), sigma) for i in found][:_MOST]


def _cell(index: int, size: float, q: float, sigma: np.ndarray) -> dict[str, Any]:
    feature = LAYOUT[index]
    out: dict[str, Any] = {'covariate': feature.axis, 'low': None, 'high': None, 'unit': '',
                           'channel': feature.channel, 'size': size}
    if feature.axis == 'structure':
        out.update(unit_size='', q_value=q)
        return out
    axis = AXES[feature.axis]
    edges = (None, *axis.edges, None)
    if axis.edges:
        out.update(low=edges[feature.place], high=edges[feature.place + 1], unit=axis.unit)
    elif feature.axis == 'edge':
        out['covariate'] = _EDGE[feature.place]
    elif feature.axis == 'region':
        row, column = divmod(feature.place, 4)
        out['covariate'] = f'image region row {row + 1} of 3, column {column + 1} of 4'
    elif feature.axis == 'beyond':
        out['covariate'] = ('nothing there', 'beyond the range')[feature.place]
    unit = CHANNELS[feature.channel][1]
    if unit == 'sigma':
        out['size'] = size * float(sigma[axis.start + feature.place]) * 1000
        unit = 'mm'
    out.update(unit_size=unit, q_value=q)
    return out


def unexplained(model: Model, residual: np.ndarray, base: np.ndarray) -> list[dict[str, Any]]:
    """
    Sum up, channel by channel, what a residual leaves over.

    Parameters
    ----------
    model : Model
        The recordings.
    residual, base : numpy.ndarray
        (R, SIZE) what is left; the loss that noise alone gives.

    Returns
    -------
    list of dict
        ``structure``, ``loss`` (above the null's) and ``share`` of all that is left.

    """
    loss = (model.weights * np.log1p(residual ** 2 / model.scale2)).sum(axis=0) - base
    names = [*CHANNELS, *STRUCTURES]
    groups = {name: sum(float(loss[i]) for i, f in enumerate(LAYOUT) if f.channel == name)
              for name in names}
    total = max(sum(v for v in groups.values() if v > 0), 1e-9)
    return [{'structure': name, 'loss': value, 'share': value / total}
            for name, value in sorted(groups.items(), key=lambda item: -item[1])
            if value > 0.05 * total]

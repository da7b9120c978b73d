"""The third panel of an effect's picture: the change over distance, time or another covariate."""

from collections.abc import Callable
from functools import partial
from typing import Any

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.cli.effects_view import (
    CHART,
    deviation_over_time,
    EffectView,
    mean_of_valid,
    near_edges,
    speed,
    STEEP,
)
from flexx2_sim_ros.effects import Effect
import numpy as np

GRAY = '#8a8a8a'
_BOTH = ('with', 'C0'), ('without', GRAY)  # names and colours


def _covariate(view: EffectView) -> tuple[str, np.ndarray, np.ndarray]:
    # The covariate's label, its value in every pixel, and the edges of bins.
    amplitude = view.scene.reflectivity * view.surface.cos_incidence / view.scene.depth**2
    incidence = np.degrees(view.surface.incidence)
    return {
        'distance': ('distance, m', view.scene.depth, np.linspace(0.4, 2.5, 80)),
        'incidence': ('incidence, degrees', incidence, np.arange(0, 91, 3.0)),
        'amplitude': ('amplitude, 1/m²', amplitude, np.geomspace(3e-3, 5, 28)),
    }.get(view.kind.covariate, ('distance, m', view.scene.depth, np.linspace(0.4, 6.8, 60)))


def _binned(values: np.ndarray, x: np.ndarray, edges: np.ndarray, reduce: Any) -> np.ndarray:
    index = np.digitize(x, edges) - 1
    out = np.full(len(edges) - 1, np.nan)
    for i in range(len(out)):
        chosen = values[index == i]
        if np.isfinite(chosen).sum() >= 20:
            out[i] = reduce(chosen[np.isfinite(chosen)])
    return out


def _by_covariate(axis: Any, view: EffectView) -> None:
    label, x, edges = _covariate(view)
    first = (*view.kind.changes, '')[0]
    calm = view.calm(5, STEEP if first == 'noise' else 90.0)
    if view.kind.picture.at_chart:
        calm &= np.abs(view.scene.depth - CHART) < 0.01  # all at one distance
    middles = 0.5 * (edges[1:] + edges[:-1])
    if view.kind.covariate == 'amplitude':
        axis.set_xscale('log')
        middles = np.sqrt(edges[1:] * edges[:-1])
    if first == 'validity':
        lines = [100 * np.isnan(seen.depth).mean(axis=0) for seen in (view.frame, view.rest)]
        text, styles = 'invalid, %', ('with', 'without')
    elif first == 'noise':
        lines = [deviation_over_time(1e3 * seen.depth) for seen in (view.frame, view.rest)]
        text, styles = 'standard deviation over frames, mm', ('with', 'without')
        axis.set_yscale('log')
    else:
        lines, styles = [mean_of_valid(view.change)], ('median', '')
        text = 'with minus without, mm'
        low, high = (
            _binned(lines[0][calm], x[calm], edges, partial(np.percentile, q=q)) for q in (10, 90)
        )
        band = np.stack([middles, low, high])[:, np.isfinite(low)]
        axis.fill_between(*band, alpha=0.2, linewidth=0, label='10 to 90 % of the pixels')
        axis.axhline(0, color=GRAY, linewidth=1)
    for values, name in zip(lines, styles, strict=False):
        mean = _binned(values[calm], x[calm], edges, np.median if name == 'median' else np.mean)
        known = np.isfinite(mean)
        colour = GRAY if name == 'without' else 'C0'
        axis.plot(middles[known], mean[known], '.-', label=name, color=colour)
    axis.set(xlabel=label, ylabel=text)


def _along_row(axis: Any, view: EffectView) -> None:
    row = 14  # across the corner
    change = np.where(near_edges(view, 6), np.nan, mean_of_valid(view.change))
    axis.plot(change[row], '.-', label=f'row {row}')
    axis.axhline(0, color=GRAY, linewidth=1)
    axis.set(xlabel='column', ylabel='with minus without, mm')


def _capture(depth: np.ndarray, *effects: Effect) -> np.ndarray:
    camera = Camera('Mode_9_30fps', effects=effects, seed=1)
    return camera.capture(depth, flexx2().intrinsics.matrix, 0).depth


def _two_scenes(axis: Any, view: EffectView) -> None:
    row, columns = 86, np.arange(90, 150)
    wall = np.full(view.scene.depth.shape, 1.0)
    alone = 1e3 * (_capture(wall, view.effect) - _capture(wall))[row, columns]
    change = mean_of_valid(view.change)[row, columns]
    axis.plot(columns, change, 'o-', markersize=3, label=f'row {row} of this scene')
    style = {'color': 'C1', 'zorder': 3, 'markersize': 4}
    axis.plot(columns, alone, '.', label='on a plain wall', **style)
    axis.axhline(0, color=GRAY, linewidth=1)
    axis.set(xlabel='column', ylabel='with minus without, mm')


def _histogram(axis: Any, view: EffectView) -> None:
    calm = view.calm(9)
    scale = 1e3 * view.rest.sigma[:, calm]
    limit = 8.0
    for error, (name, colour) in zip(view.error, _BOTH, strict=True):
        values = error[:, calm] / scale
        shown = values[np.isfinite(values)]
        _outline(axis, shown, np.linspace(-limit, limit, 161), name, colour)
    axis.set(yscale='log', ylim=(1e-5, 1), xlim=(-limit, limit))
    axis.set(xlabel='error / modelled sigma', ylabel='density')


def _outline(axis: Any, values: np.ndarray, bins: np.ndarray, name: str, colour: str) -> None:
    axis.hist(values, bins, density=True, histtype='step', color=colour, label=name)


# Rows and columns that contain the chart's left edge.
_EDGE_ROWS, _EDGE_COLUMNS = slice(30, 70), slice(78, 108)


def _true_edge(view: EffectView) -> int:
    return int((view.clean[0, 60, _EDGE_COLUMNS] > 1.8).sum())


def _across_edge(axis: Any, view: EffectView) -> None:
    seen_both = (view.frame, 0.0), (view.rest, 0.3)
    for (seen, aside), (name, colour) in zip(seen_both, _BOTH, strict=True):
        depth = seen.depth[::8, _EDGE_ROWS, _EDGE_COLUMNS]
        x = np.broadcast_to(np.arange(depth.shape[2]) - _true_edge(view) + aside, depth.shape)
        axis.plot(x.ravel(), depth.ravel(), '.', color=colour, markersize=3, label=name)
    labels = {'xlabel': 'columns from the edge of the chart', 'ylabel': 'depth, m'}
    axis.set(xlim=(-9, 9), ylim=(1.4, 2.3), **labels)


def _edge_positions(axis: Any, view: EffectView) -> None:
    bins = np.arange(-12.5, 13.5)
    for seen, (name, colour) in zip((view.frame, view.rest), _BOTH, strict=True):
        far = seen.depth[:, _EDGE_ROWS, _EDGE_COLUMNS] > 1.8
        moved = far.sum(axis=2) - _true_edge(view)
        _outline(axis, moved.ravel(), bins, f'{name}: {moved.std():.2f} px', colour)
    axis.set(
        xlabel='displacement of the edge of the chart, columns', ylabel='density', yscale='log'
    )


def _warming_up(axis: Any, view: EffectView) -> None:
    axis.plot(view.seconds / 60, [np.nanmean(one) for one in view.change], '.-')
    axis.set(xlabel='minutes since power-on', ylabel='with minus without, mm')
    axis.axhline(0, color=GRAY, linewidth=0.5)


def _moving(axis: Any, view: EffectView) -> None:
    # The camera moves towards the far wall and the chart and back.
    if view.kind.picture.difference == 'lost':
        lost = np.isnan(view.frame.depth) & np.isfinite(view.rest.depth)
        change, label = 1000 * lost.mean(axis=(1, 2)), 'invalid with the effect alone, per mille'
        where = 'all pixels'
    else:
        calm = ~near_edges(view, 20) & (np.abs(view.surface.cos_incidence - 1) < 0.1)
        change = np.array([np.nanmedian(one[calm]) for one in view.change])
        label, where = 'with minus without, mm', 'median over surfaces that face the camera'
    axis.plot(view.seconds, change, '.-', label=label)
    axis.plot(view.seconds, 10 * speed(view.seconds), color=GRAY, label='speed forward, 0.1 m/s')
    axis.axhline(0, color=GRAY, linewidth=0.5)
    axis.set(xlabel='time, s', ylabel=where)


def _correlations(axis: Any, view: EffectView, what: str) -> None:
    # Between frames, once filters have settled in, or between the pixels of a row.
    calm = view.calm(12, 45.0)
    lags = range(6)
    for error, (name, colour) in zip(view.error, _BOTH, strict=True):
        noise = np.where(calm, error - mean_of_valid(error), np.nan) / (1e3 * view.rest.sigma)
        line = noise[5:] if what == 'frames' else np.moveaxis(noise, 2, 0)
        values = [_correlation(line[lag:], line[: len(line) - lag]) for lag in lags]
        axis.plot(lags, values, 'o-', color=colour, label=name)
    axis.set(xlabel=f'{what} apart', ylabel='correlation of the noise')


def _correlation(one: np.ndarray, other: np.ndarray) -> float:
    both = np.isfinite(one) & np.isfinite(other)
    return float(np.corrcoef(one[both], other[both])[0, 1])


def _wrapped(axis: Any, view: EffectView) -> None:
    # With two frequencies, and with one.
    calm = view.calm(9, 78.0)
    x = np.broadcast_to(view.clean, view.frame.depth.shape)[-1][calm]
    axis.plot(x, view.frame.depth[-1][calm], '.', markersize=2, label=view.kind.picture.usecase)
    far = _capture(view.scene.depth, view.effect)
    axis.plot(x, far[calm], '.', markersize=2, color='C1', zorder=1, label='Mode_9_30fps')
    axis.set(xlabel='true distance, m', ylabel='depth, m')


def _steps(axis: Any, view: EffectView) -> None:
    calm = view.calm(9, 78.0)
    x = view.rest.depth[-1][calm]
    near = (x > 1.3) & (x < 1.33)
    axis.plot(x[near], view.change[-1][calm][near], '.', markersize=3)
    axis.set(xlabel='depth without, m', ylabel='with minus without, mm')


# By the names in `flexx2_sim_ros.effects.picture`.
DRAW_PROFILE: dict[str, Callable[[Any, EffectView], None]] = {
    'covariate': _by_covariate,
    'along_row': _along_row,
    'two_scenes': _two_scenes,
    'histogram': _histogram,
    'across_edge': _across_edge,
    'edge_positions': _edge_positions,
    'warming_up': _warming_up,
    'moving': _moving,
    'frames_alike': partial(_correlations, what='frames'),
    'neighbours_alike': partial(_correlations, what='pixels'),
    'wrapped': _wrapped,
    'steps': _steps,
}

"""The picture of one effect: a scene, what changes in it, and what that depends on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

from flexx2_sim_ros.atomic import whole
from flexx2_sim_ros.camera import Camera, flexx2, Frame
from flexx2_sim_ros.cli.effects_scene import CHART, Room, room, speed, way
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.physics.frame_state import Stage
from flexx2_sim_ros.physics.surface import analyse, Surface
import numpy as np

_FRAMES = 80
_STEEP = 40.0  # degrees: beyond it the noise drowns all else
_GRAY = '#8a8a8a'
_INVALID = '#3a3a3a'


@dataclass(frozen=True)
class _View:
    # What an effect's cameras saw. Depths: (T, H, W) metres; `rest`: without it.
    kind: type[Effect]
    scene: Room
    clean: np.ndarray
    surface: Surface
    seconds: np.ndarray
    frame: Frame
    rest: Frame

    @property
    def change(self) -> np.ndarray:
        """By how much the effect changes each pixel, mm."""
        return 1e3 * (self.frame.depth - self.rest.depth)

    def calm(self, reach: int, steepest: float = _STEEP) -> np.ndarray:
        """Return which pixels are away from edges and not too steep."""
        return ~_near_edges(self, reach) & (np.degrees(self.surface.incidence) < steepest)

    @property
    def error(self) -> tuple[np.ndarray, np.ndarray]:
        """Return noise and bias with and without the effect, mm."""
        with_it, without = (1e3 * (seen.depth - self.clean) for seen in (self.frame, self.rest))
        return with_it, without


def draw(path: Path, kind: type[Effect]) -> None:
    """
    Write the picture of an effect at its typical strength.

    Parameters
    ----------
    path : pathlib.Path
        PNG to write.
    kind : type of Effect
        One of the registry's.

    Raises
    ------
    InputError
        When the picture cannot be written.

    """
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    view = _look(kind)
    figure, axes = pyplot.subplots(
        1, 3, figsize=(13.5, 4.3), layout='constrained', width_ratios=(1, 1, 1.15)
    )
    scene, difference, profile = axes
    depths = pyplot.get_cmap('turbo_r').with_extremes(bad=_INVALID)
    shown = scene.imshow(
        view.frame.depth[-1], cmap=depths, norm='log', vmin=0.4, vmax=7, interpolation='nearest'
    )
    bar = figure.colorbar(shown, ax=scene, shrink=0.75, ticks=[0.5, 1, 2, 4, 7])
    bar.ax.minorticks_off()
    bar.ax.set_yticklabels(['0.5', '1', '2', '4', '7 m'])
    scene.set_title('seen with the effect (dark: invalid)', fontsize=10)
    _draw_difference(figure, difference, view)
    _PROFILES[kind.picture.profile_for(kind.covariate)](profile, view)
    for axis in (scene, difference):
        axis.set(xticks=[], yticks=[])
    profile.grid(alpha=0.3)
    profile.spines[['top', 'right']].set_visible(False)
    if profile.get_legend_handles_labels()[0]:
        profile.legend(frameon=False, fontsize=9)
    figure.suptitle(f'{kind.name}: {fill(kind.title, 110)}', fontsize=12)
    try:
        with whole(path) as part:
            figure.savefig(part, dpi=90, format='png')
    finally:
        pyplot.close(figure)


def _look(kind: type[Effect]) -> _View:
    scene = room()
    spec = kind.picture
    last = (_FRAMES - 1) / 30 if spec.seconds is None else spec.seconds
    seconds = np.linspace(0, last, _FRAMES)
    moves = not kind.changes
    rooms = [room(float(forward)) for forward in way(seconds)] if moves else [scene]
    clean = np.stack([one.depth for one in rooms])
    shade = np.stack([one.reflectivity for one in rooms])
    camera = flexx2()
    matrix = camera.intrinsics.matrix
    frame, rest = (
        Camera(spec.usecase, effects=effects, seed=1).capture(clean, matrix, seconds, shade)
        for effects in ({kind.name: None}, ())
    )
    surface = analyse(scene.depth.astype(np.float32), camera.intrinsics, camera.sensor)
    return _View(
        kind, scene, np.broadcast_to(clean, frame.depth.shape), surface, seconds, frame, rest
    )


def _mean(frames: np.ndarray) -> np.ndarray:
    # Over time, NaN where there never was anything; without a warning.
    count = np.isfinite(frames).sum(axis=0)
    mean: np.ndarray = np.nansum(frames, axis=0) / np.where(count, count, np.nan)
    return mean


def _spread(frames: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(_mean(frames**2) - _mean(frames) ** 2, 0))


def _draw_difference(figure: Any, axis: Any, view: _View) -> None:
    kind = view.kind.picture.difference_for(view.kind.changes)
    if kind == 'lost':
        lost = np.isnan(view.frame.depth) & np.isfinite(view.rest.depth)
        shown = axis.imshow(
            100 * lost.mean(axis=0), cmap='magma', vmin=0, vmax=100, interpolation='nearest'
        )
        axis.set_title('invalid pixels, % of frames', fontsize=10)
    elif kind == 'beyond':
        new = np.where(
            np.isfinite(view.frame.depth[-1]) & np.isnan(view.rest.depth[-1]),
            view.frame.depth[-1] - view.clean[-1],
            np.nan,
        )
        shown = axis.imshow(new, cmap='viridis', interpolation='nearest')
        axis.set_title('depth of pixels that should be invalid, minus true depth, m', fontsize=10)
    elif kind == 'spread':
        with np.errstate(divide='ignore', invalid='ignore'):
            ratio = np.log2(_spread(view.frame.depth) / _spread(view.rest.depth))
        limit = max(0.5, float(np.nanpercentile(np.abs(ratio), 98)))
        shown = axis.imshow(ratio, cmap='PuOr_r', vmin=-limit, vmax=limit, interpolation='nearest')
        axis.set_title('standard deviation over frames: log2 of with / without', fontsize=10)
    else:
        fastest = int(speed(view.seconds).argmax())
        image = (
            _mean(view.change)
            if kind == 'mean'
            else view.change[0 if kind == 'first' else fastest]
        )
        if view.kind.stage == Stage.GEOMETRY:
            image[_near_edges(view, 6)] = np.nan  # Edges that have moved hide the rest.
        limit = max(0.5, float(np.nanpercentile(np.abs(image[np.abs(image) > 1e-3]), 97)))
        shown = axis.imshow(
            image, cmap=_diverging(), vmin=-limit, vmax=limit, interpolation='nearest'
        )
        axis.set_title(
            ('mean' if kind == 'mean' else 'one frame') + ' with minus without, mm', fontsize=10
        )
    figure.colorbar(shown, ax=axis, shrink=0.75)


def _diverging() -> Any:
    from matplotlib import pyplot

    return pyplot.get_cmap('RdBu').with_extremes(bad=_INVALID)


def _near_edges(view: _View, reach: int) -> np.ndarray:
    # Pixels within `reach` of a depth jump.
    near = (view.surface.row_jumps | view.surface.column_jumps).astype(bool)
    for axis in (0, 1):
        wide = near.copy()
        for step in range(1, reach + 1):
            wide |= np.roll(near, step, axis) | np.roll(near, -step, axis)
        near = wide
    return near


def _covariate(view: _View) -> tuple[str, np.ndarray, np.ndarray]:
    # Its name, its value in every pixel, and where bins begin and end.
    amplitude = view.scene.reflectivity * view.surface.cos_incidence / view.scene.depth**2
    return {
        'distance': ('distance, m', view.scene.depth, np.linspace(0.4, 2.5, 80)),
        'incidence': (
            'incidence, degrees',
            np.degrees(view.surface.incidence),
            np.arange(0, 91, 3.0),
        ),
        'amplitude': ('amplitude, 1/m²', amplitude, np.geomspace(3e-3, 5, 28)),
    }.get(view.kind.covariate, ('distance, m', view.scene.depth, np.linspace(0.4, 6.8, 60)))


def _binned(
    values: np.ndarray,
    x: np.ndarray,
    edges: np.ndarray,
    reduce: Callable[[np.ndarray], float] = np.nanmean,
) -> np.ndarray:
    index = np.digitize(x, edges) - 1
    out = np.full(len(edges) - 1, np.nan)
    for i in range(len(out)):
        chosen = values[index == i]
        if np.isfinite(chosen).sum() >= 20:
            out[i] = reduce(chosen[np.isfinite(chosen)])
    return out


def _by_covariate(axis: Any, view: _View) -> None:
    label, x, edges = _covariate(view)
    first = (*view.kind.changes, '')[0]
    calm = view.calm(5, _STEEP if first == 'noise' else 90.0)
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
        lines = [_spread(1e3 * seen.depth) for seen in (view.frame, view.rest)]
        text, styles = 'standard deviation over frames, mm', ('with', 'without')
        axis.set_yscale('log')
    else:
        lines, text, styles = [_mean(view.change)], 'with minus without, mm', ('median', '')
        low, high = (
            _binned(
                lines[0][calm],
                x[calm],
                edges,
                lambda part, q=q: float(np.percentile(part, q)),  # type: ignore[misc]
            )
            for q in (10, 90)
        )
        known = np.isfinite(low)
        axis.fill_between(
            middles[known],
            low[known],
            high[known],
            alpha=0.2,
            linewidth=0,
            label='10 to 90 % of the pixels',
        )
        axis.axhline(0, color=_GRAY, linewidth=1)
    for values, name in zip(lines, styles, strict=False):
        mean = _binned(values[calm], x[calm], edges, np.median if name == 'median' else np.mean)
        known = np.isfinite(mean)
        axis.plot(
            middles[known],
            mean[known],
            '.-',
            label=name,
            color=_GRAY if name == 'without' else 'C0',
        )
    axis.set(xlabel=label, ylabel=text)


def _along_row(axis: Any, view: _View) -> None:
    row = 14  # across the corner
    axis.plot(
        np.where(_near_edges(view, 6), np.nan, _mean(view.change))[row], '.-', label=f'row {row}'
    )
    axis.axhline(0, color=_GRAY, linewidth=1)
    axis.set(xlabel='column', ylabel='with minus without, mm')


def _two_scenes(axis: Any, view: _View) -> None:
    row, columns = 86, np.arange(90, 150)
    wall = np.full(view.scene.depth.shape, 1.0)
    with_it, without = (
        Camera('Mode_9_30fps', effects=effects, seed=1)
        .capture(wall, flexx2().intrinsics.matrix, 0)
        .depth
        for effects in ({view.kind.name: None}, ())
    )
    axis.plot(
        columns,
        _mean(view.change)[row, columns],
        'o-',
        markersize=3,
        label=f'row {row} of this scene',
    )
    axis.plot(
        columns,
        1e3 * (with_it - without)[row, columns],
        '.',
        color='C1',
        zorder=3,
        markersize=4,
        label='on a plain wall',
    )
    axis.axhline(0, color=_GRAY, linewidth=1)
    axis.set(xlabel='column', ylabel='with minus without, mm')


def _histogram(axis: Any, view: _View) -> None:
    calm = view.calm(9)
    scale = 1e3 * view.rest.sigma[:, calm]
    limit = 8.0
    for error, name, colour in zip(view.error, ('with', 'without'), ('C0', _GRAY), strict=True):
        values = error[:, calm] / scale
        axis.hist(
            values[np.isfinite(values)],
            np.linspace(-limit, limit, 161),
            density=True,
            histtype='step',
            color=colour,
            label=name,
        )
    axis.set(
        xlabel='error / modelled sigma',
        ylabel='density',
        yscale='log',
        ylim=(1e-5, 1),
        xlim=(-limit, limit),
    )


# Where the chart's left edge is in every row.
_EDGE_ROWS, _EDGE_COLUMNS = slice(30, 70), slice(78, 108)


def _true_edge(view: _View) -> int:
    return int((view.clean[0, 60, _EDGE_COLUMNS] > 1.8).sum())


def _across_edge(axis: Any, view: _View) -> None:
    for seen, name, colour, aside in (
        (view.frame, 'with', 'C0', 0.0),
        (view.rest, 'without', _GRAY, 0.3),
    ):
        depth = seen.depth[::8, _EDGE_ROWS, _EDGE_COLUMNS]
        x = np.broadcast_to(np.arange(depth.shape[2]) - _true_edge(view) + aside, depth.shape)
        axis.plot(x.ravel(), depth.ravel(), '.', color=colour, markersize=3, label=name)
    axis.set(
        xlabel='columns from the edge of the chart',
        ylabel='depth, m',
        xlim=(-9, 9),
        ylim=(1.4, 2.3),
    )


def _edge_positions(axis: Any, view: _View) -> None:
    bins = np.arange(-12.5, 13.5)
    for seen, name, colour in ((view.frame, 'with', 'C0'), (view.rest, 'without', _GRAY)):
        far = seen.depth[:, _EDGE_ROWS, _EDGE_COLUMNS] > 1.8
        moved = far.sum(axis=2) - _true_edge(view)
        axis.hist(
            moved.ravel(),
            bins,
            density=True,
            histtype='step',
            color=colour,
            label=f'{name}: {moved.std():.2f} px',
        )
    axis.set(
        xlabel='displacement of the edge of the chart, columns', ylabel='density', yscale='log'
    )


def _warming_up(axis: Any, view: _View) -> None:
    axis.plot(view.seconds / 60, [np.nanmean(one) for one in view.change], '.-')
    axis.set(xlabel='minutes since power-on', ylabel='with minus without, mm', ylim=(0, None))


def _moving(axis: Any, view: _View) -> None:
    # The far wall and the chart come nearer and go away again.
    calm = ~_near_edges(view, 20) & (np.abs(view.surface.cos_incidence - 1) < 0.1)
    axis.plot(
        view.seconds,
        [np.nanmedian(one[calm]) for one in view.change],
        '.-',
        label='with minus without, mm',
    )
    axis.plot(view.seconds, 10 * speed(view.seconds), color=_GRAY, label='speed forward, 0.1 m/s')
    axis.axhline(0, color=_GRAY, linewidth=0.5)
    axis.set(xlabel='time, s', ylabel='median over surfaces that face the camera')


def _correlation(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[float]:
    result = []
    for one, other in pairs:
        both = np.isfinite(one) & np.isfinite(other)
        result.append(float(np.corrcoef(one[both], other[both])[0, 1]))
    return result


def _frames_alike(axis: Any, view: _View) -> None:
    _correlations(
        axis, view, 'frames', lambda noise, lag: (noise[lag + 5 :], noise[5 : len(noise) - lag])
    )


def _neighbours_alike(axis: Any, view: _View) -> None:
    _correlations(
        axis,
        view,
        'pixels',
        lambda noise, lag: (noise[:, :, lag:], noise[:, :, : noise.shape[2] - lag]),
    )


def _correlations(
    axis: Any,
    view: _View,
    what: str,
    pair: Callable[[np.ndarray, int], tuple[np.ndarray, np.ndarray]],
) -> None:
    calm = view.calm(12, 45.0)
    lags = range(6)
    for error, name, colour in zip(view.error, ('with', 'without'), ('C0', _GRAY), strict=True):
        noise = np.where(calm, error - _mean(error), np.nan) / (1e3 * view.rest.sigma)
        values = _correlation([pair(noise, lag) for lag in lags])
        axis.plot(lags, values, 'o-', color=colour, label=name)
    axis.set(xlabel=f'{what} apart', ylabel='correlation of the noise')


def _wrapped(axis: Any, view: _View) -> None:
    # With two frequencies, and with one.
    calm = view.calm(9, 78.0)
    x = np.broadcast_to(view.clean, view.frame.depth.shape)[-1][calm]
    axis.plot(x, view.frame.depth[-1][calm], '.', markersize=2, label=view.kind.picture.usecase)
    far = (
        Camera('Mode_9_30fps', effects={view.kind.name: None}, seed=1)
        .capture(view.scene.depth, flexx2().intrinsics.matrix, 0)
        .depth
    )
    axis.plot(x, far[calm], '.', markersize=2, color='C1', zorder=1, label='Mode_9_30fps')
    axis.set(xlabel='true distance, m', ylabel='depth, m')


def _steps(axis: Any, view: _View) -> None:
    calm = view.calm(9, 78.0)
    x = view.rest.depth[-1][calm]
    near = (x > 1.3) & (x < 1.33)
    axis.plot(x[near], view.change[-1][calm][near], '.', markersize=3)
    axis.set(xlabel='depth without, m', ylabel='with minus without, mm')


# By the names in `flexx2_sim_ros.effects.picture`.
_PROFILES: dict[str, Callable[[Any, _View], None]] = {
    'covariate': _by_covariate,
    'along_row': _along_row,
    'two_scenes': _two_scenes,
    'histogram': _histogram,
    'across_edge': _across_edge,
    'edge_positions': _edge_positions,
    'warming_up': _warming_up,
    'moving': _moving,
    'frames_alike': _frames_alike,
    'neighbours_alike': _neighbours_alike,
    'wrapped': _wrapped,
    'steps': _steps,
}

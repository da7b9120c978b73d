"""The picture of one effect: the scene, the change, and how the change depends on a covariate."""

from pathlib import Path
from textwrap import fill
from typing import Any

from flexx2_sim_ros.cli.effects_profiles import DRAW_PROFILE
from flexx2_sim_ros.cli.effects_view import (
    deviation_over_time,
    EffectView,
    look,
    mean_of_valid,
    near_edges,
    speed,
)
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.physics.frame_state import Stage
from flexx2_sim_ros.pictures import colours, picture
import numpy as np


def draw(path: Path, effect: Effect) -> None:
    """Write the picture of an effect, PNG; raise `InputError` when it cannot be written."""
    view = look(effect)
    size = {'figsize': (13.5, 4.3), 'width_ratios': (1, 1, 1.15)}
    with picture(path, 1, 3, dpi=90, **size) as (figure, axes):
        _fill(figure, axes, view)


def _fill(figure: Any, axes: Any, view: EffectView) -> None:
    kind = view.kind
    scene, difference, profile = axes
    shown = scene.imshow(
        view.frame.depth[-1],
        cmap=colours('turbo_r'),
        norm='log',
        vmin=0.4,
        vmax=7,
        interpolation='nearest',
    )
    bar = figure.colorbar(shown, ax=scene, shrink=0.75, ticks=[0.5, 1, 2, 4, 7])
    bar.ax.minorticks_off()
    bar.ax.set_yticklabels(['0.5', '1', '2', '4', '7 m'])
    scene.set_title('seen with the effect (dark: invalid)', fontsize=10)
    _draw_difference(figure, difference, view)
    DRAW_PROFILE[kind.picture.profile_for(kind.covariate)](profile, view)
    for axis in (scene, difference):
        axis.set(xticks=[], yticks=[])
    profile.grid(alpha=0.3)
    profile.spines[['top', 'right']].set_visible(False)
    if profile.get_legend_handles_labels()[0]:
        profile.legend(frameon=False, fontsize=9)
    figure.suptitle(f'{kind.name}: {fill(kind.title, 110)}', fontsize=12)


def _draw_difference(figure: Any, axis: Any, view: EffectView) -> None:
    kind = view.kind.picture.difference_for(view.kind.changes)
    frame, rest = view.frame.depth, view.rest.depth
    if kind == 'lost':
        image = 100 * (np.isnan(frame) & np.isfinite(rest)).mean(axis=0)
        style = {'cmap': 'magma', 'vmin': 0, 'vmax': max(float(image.max()), 1.0)}
        title = 'invalid pixels, % of frames'
    elif kind == 'beyond':
        new = np.isfinite(frame[-1]) & np.isnan(rest[-1])
        image, style = np.where(new, frame[-1] - view.clean[-1], np.nan), {'cmap': 'viridis'}
        title = 'depth of pixels that should be invalid, minus true depth, m'
    elif kind == 'spread':
        with np.errstate(divide='ignore', invalid='ignore'):
            image = np.log2(deviation_over_time(frame) / deviation_over_time(rest))
        style = _around_zero('PuOr_r', float(np.nanpercentile(np.abs(image), 98)))
        title = 'standard deviation over frames: log2 of with / without'
    else:
        fastest = int(speed(view.seconds).argmax())
        one = view.change[0 if kind == 'first' else fastest]
        image = mean_of_valid(view.change) if kind == 'mean' else one
        if view.kind.stage == Stage.GEOMETRY:
            image[near_edges(view, 6)] = np.nan  # Moved edges would hide the other changes.
        changed = np.abs(image[np.abs(image) > 1e-3])
        style = _around_zero(colours('RdBu'), float(np.nanpercentile(changed, 97)))
        title = ('mean' if kind == 'mean' else 'one frame') + ' with minus without, mm'
    shown = axis.imshow(image, interpolation='nearest', **style)
    axis.set_title(title, fontsize=10)
    figure.colorbar(shown, ax=axis, shrink=0.75)


def _around_zero(cmap: Any, limit: float) -> dict[str, Any]:
    most = max(0.5, limit)
    return {'cmap': cmap, 'vmin': -most, 'vmax': most}

"""The figure of walks: how often they fail against step height."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import whole

_STEP_IS = {'stairs': 'rise of a stair', 'rubble': 'highest block', 'gaps': 'depth of a gap'}
# Colours that people with colour blindness can tell apart (Okabe and Ito).
_COLOURS = '#000000', '#0072b2', '#d55e00', '#009e73', '#cc79a7'
_MARKERS = 'osD^v'
_APART = 0.15  # centimetres between the curves, so that intervals do not cover each other


def draw_walks(path: Path, rows: Sequence[dict[str, Any]], title: str) -> None:
    """Draw a panel for each terrain and a curve for each camera, of `series.rows`, as a PNG."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    terrains = list(dict.fromkeys(row['terrain'] for row in rows))
    cameras = list(dict.fromkeys(row['camera'] for row in rows))
    figure, axes = pyplot.subplots(
        1, len(terrains), figsize=(4.4 * len(terrains), 4), layout='constrained', sharey=True
    )
    for axis, terrain in zip(axes, terrains, strict=True):
        for number, camera in enumerate(cameras):
            own = [one for one in rows if (one['terrain'], one['camera']) == (terrain, camera)]
            share = [100 * one['share'] for one in own]
            low, high = zip(*(one['interval'] for one in own), strict=True)
            shift = _APART * (number - (len(cameras) - 1) / 2)
            axis.errorbar(
                [100 * one['step'] + shift for one in own],
                share,
                [
                    [one - 100 * bound for one, bound in zip(share, low, strict=True)],
                    [100 * bound - one for one, bound in zip(share, high, strict=True)],
                ],
                color=_COLOURS[number % len(_COLOURS)],
                marker=_MARKERS[number % len(_MARKERS)],
                markersize=5,
                linewidth=1.2,
                capsize=2,
                label=camera,
            )
        axis.set(title=terrain, xlabel=f'{_STEP_IS[terrain]} [cm]', ylim=(-3, 103))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel('walks that fail [%]')
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=5)
    figure.suptitle(title)
    with whole(path) as part:
        figure.savefig(part, dpi=100, format='png')
    pyplot.close(figure)

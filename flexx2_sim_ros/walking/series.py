"""Walks over all terrains and step heights: failures of each camera, with intervals, and drawn."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import logging
from pathlib import Path
from typing import Any

from flexx2_sim_ros.batch.host import HostCameras
from flexx2_sim_ros.jobs import Map
from flexx2_sim_ros.pictures import picture
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode
from flexx2_sim_ros.walking.cameras import WalkingCamera
from flexx2_sim_ros.walking.footsteps import REASONS
from flexx2_sim_ros.walking.terrain import KINDS
from flexx2_sim_ros.walking.walks import Point, walk
import numpy as np
from scipy.stats import binomtest
import warp as wp

# Rise of a stair, height of the highest rubble, or depth of a gap, metres. The gait reaches 0.2 m.
STEPS = (0.03, 0.06, 0.09, 0.12, 0.15)
_TOGETHER = 25  # walks in one batch, for their images to fit into 0.5 GB
_STEP_IS = {'stairs': 'rise of a stair', 'rubble': 'highest block', 'gaps': 'depth of a gap'}
# Colours that people with colour blindness can tell apart (Okabe and Ito).
_COLOURS = '#000000', '#0072b2', '#d55e00', '#009e73', '#cc79a7'
_MARKERS = 'osD^v'
_APART = 0.15  # centimetres between the curves, so that intervals do not cover each other

# By terrain and step height, by camera: (N,) as `walk` returns.
Failures = dict[tuple[str, float], dict[str, np.ndarray]]


def batches(walks: int, steps: Sequence[float] = STEPS) -> list[Point]:
    """Return the walks of all terrains and step heights in batches."""
    return [
        Point(kind, step, first, min(_TOGETHER, walks - first))
        for kind in KINDS
        for step in dict.fromkeys(steps)
        for first in range(0, walks, _TOGETHER)
    ]


def walk_all(
    points: Sequence[Point],
    cameras: Mapping[str, WalkingCamera],
    lens: Intrinsics,
    mode: Mode,
    mapped: Map,
    tick: Callable[[], None],
    **options: Any,
) -> Failures:
    """
    Walk all batches; the options are ``seed``, ``robot`` and ``least`` of `walk`.

    ``points`` are from `batches`, ``mapped`` is a map as from `jobs.workers`, and ``tick`` is
    called after each batch. ``cameras``, ``lens`` and ``mode`` are as for `walk`.
    """
    work = partial(walk_quietly, cameras=dict(cameras), lens=lens, mode=mode, **options)
    found: dict[tuple[str, float], list[dict[str, np.ndarray]]] = {}
    for point, failed in zip(points, mapped(work, points, tick), strict=True):
        found.setdefault((point.terrain, point.step), []).append(failed)
    return {
        key: {name: np.concatenate([part[name] for part in parts]) for name in cameras}
        for key, parts in found.items()
    }


def walk_quietly(point: Point, **options: Any) -> dict[str, np.ndarray]:
    """Call `walk` without what Warp and `BatchCamera` report about kernels in every batch."""
    host = logging.getLogger(HostCameras.__module__)
    before = wp.config.log_level, host.level
    wp.config.log_level = wp.LOG_WARNING
    host.setLevel(logging.ERROR)
    try:
        return walk(point, **options)
    finally:
        wp.config.log_level = before[0]
        host.setLevel(before[1])


def rows(failures: Failures) -> list[dict[str, Any]]:
    """Return a row for each terrain, step height and camera, as `docs/robots.md` describes."""
    out = []
    for (terrain, step), cameras in failures.items():
        for name, failed in cameras.items():
            count, bad = len(failed), int((failed >= 0).sum())
            interval = binomtest(bad, count).proportion_ci(method='wilson')
            out.append(
                {
                    'terrain': terrain,
                    'step': step,
                    'camera': name,
                    'walks': count,
                    'failed': bad,
                    'share': bad / count,
                    'interval': [float(interval.low), float(interval.high)],
                    'reasons': {
                        reason: int((failed == k).sum()) for k, reason in enumerate(REASONS)
                    },
                }
            )
    return out


def draw_walks(path: Path, rows: Sequence[dict[str, Any]], title: str) -> None:
    """Draw a panel for each terrain and a curve for each camera, of `rows`, as a PNG."""
    terrains = list(dict.fromkeys(row['terrain'] for row in rows))
    cameras = list(dict.fromkeys(row['camera'] for row in rows))
    size = 4.4 * len(terrains), 4
    with picture(path, 1, len(terrains), figsize=size, sharey=True) as (figure, axes):
        for axis, terrain in zip(axes, terrains, strict=True):
            own = [row for row in rows if row['terrain'] == terrain]
            _draw_terrain(axis, own, cameras)
            axis.set(title=terrain, xlabel=f'{_STEP_IS[terrain]} [cm]', ylim=(-3, 103))
            axis.grid(alpha=0.3)
        axes[0].set_ylabel('walks that fail [%]')
        figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=5)
        figure.suptitle(title)


def _draw_terrain(axis: Any, rows: Sequence[dict[str, Any]], cameras: list[str]) -> None:
    for number, camera in enumerate(cameras):
        own = [one for one in rows if one['camera'] == camera]
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

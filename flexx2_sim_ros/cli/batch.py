"""`flexx2 batch`: many robots on stairs, their cameras in one batch, and height grids."""

import argparse
from collections.abc import Callable
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros.atomic import checked_target
from flexx2_sim_ros.cli.effects_view import mean_of_valid
from flexx2_sim_ros.cli.options import SEEDS, whole_number
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import centred
from flexx2_sim_ros.pictures import colours, picture
from flexx2_sim_ros.profiles.files import find_profile
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

_MOST_WALKS = 256  # Walking is not batched: if there are more robots, several have the same walk.
_INTERVAL = 0.2  # seconds between the frames that go into the grid
OPTIONS = f"""
Simulate Go1 robots that walk over stairs, each with two cameras. All images get their noise in one
batch (flexx2_sim_ros.batch) and are projected to the height grid around each robot (x +-0.5 m, y
+-0.3 m, every 0.1 m). Prints and draws the errors of the grids with and without noise. Needs pip
install "flexx2_sim_ros[figures,mujoco]".

--num-envs NUM_ENVS: number of robots (default %(default)s)
--frames FRAMES: frames for each grid, {_INTERVAL} s apart (default %(default)s)
--profile
--usecase MODE: mode (default: the camera's usual one)
--seed SEED: seed of the noise (default 0)
--device DEVICE: cpu, cuda, cuda:1, ...; default: a GPU if there is one
--renderer RENDERER: auto, mujoco-warp, egl, osmesa or ray (default %(default)s)
--out OUT: picture to write (default %(default)s)

examples: flexx2 batch; on a GPU with mujoco-warp: flexx2 batch --num-envs 4096 --device cuda
"""
VALUES = {
    'num_envs': {'type': whole_number(1, 1_000_000), 'default': 64},
    'frames': {'type': whole_number(1, 100_000), 'default': 8},
    'seed': {'type': whole_number(*SEEDS), 'default': 0},
    'renderer': 'auto',
    'out': {'type': Path, 'default': Path('height_grid.png')},
}


def run(arguments: argparse.Namespace) -> int:
    """Run the example."""
    checked_target(arguments.out)
    profile = find_profile(arguments.profile)
    usecase = profile.mode(arguments.usecase or profile.default_usecase).name
    wp = import_warp()
    from flexx2_sim_ros.batch import BatchCamera
    from flexx2_sim_ros.batch.height_grid import HeightGrid
    from flexx2_sim_ros.batch.rendering import open_batch_renderer
    from flexx2_sim_ros.batch.walking import walk
    from flexx2_sim_ros.robots.model import build_model
    from flexx2_sim_ros.robots.robot import load_mounts

    console, count = Console(markup=False), arguments.num_envs
    console.width = max(console.width, 90)
    intrinsics = centred(profile.intrinsics)
    names = tuple(mount.name for mount in load_mounts())
    options = {'profile': profile, 'seed': arguments.seed, 'device': arguments.device}
    cameras = [
        BatchCamera(count, usecase, name=name, K=intrinsics.matrix, **options) for name in names
    ]
    device = cameras[0].device
    model = build_model(scene='stairs', intrinsics=intrinsics)
    with console.status(f'{min(count, _MOST_WALKS)} robots walk'):
        walks = walk(
            model, names, min(count, _MOST_WALKS), arguments.frames, _INTERVAL, seed=arguments.seed
        )
    envs = np.arange(count) % _MOST_WALKS
    renderer = open_batch_renderer(model, names, intrinsics, count, device, arguments.renderer)
    clean, noisy = (HeightGrid(count, intrinsics, device) for _ in range(2))
    timer = _Timer(lambda: wp.synchronize_device(device))
    with console.status('rendering, noise, grids (the first time compiles)'):
        for frame in range(arguments.frames):
            timer.start()
            images = renderer.render(walks.qpos[frame, envs])
            timer.lap()
            seen = [camera(image) for camera, image in zip(cameras, images, strict=True)]
            timer.lap()
            poses = walks.camera_position[frame, envs], walks.camera_rotation[frame, envs]
            for grid, depths in ((clean, images), (noisy, seen)):
                for index, depth in enumerate(depths):
                    grid.add(depth, *(one[:, index] for one in poses))
            timer.lap()
    truth = walks.heights[envs]
    grids = {
        'without noise': clean.heights().numpy() - truth,
        'with noise': noisy.heights().numpy() - truth,
    }
    console.print(
        f'{count} robots with {len(names)} cameras, {arguments.frames} frames, '
        f'{cameras[0].usecases[0]}, on {device}, rendered by {renderer.backend}; '
        f'{count * len(names)} images: {timer.text()}',
        highlight=False,
    )
    console.print(_table(grids))
    draw(arguments.out, images[0].numpy(), seen[0].numpy(), truth, grids)
    console.print(f'picture: {arguments.out}', highlight=False)
    return 0


def import_warp() -> Any:
    """Import Warp quietly, or raise `InputError` that says how to install it."""
    try:
        import warp
    except ImportError as error:
        raise InputError('warp-lang is not installed: pip install warp-lang') from error
    warp.config.log_level = warp.LOG_WARNING
    return warp


class _Timer:
    # Times of the steps of each frame. The first frame, which compiles, does not count.

    def __init__(self, wait: Callable[[], None]) -> None:
        self._wait = wait  # until the device has done its work
        self._clocks: list[list[float]] = []

    def start(self) -> None:
        self._clocks.append([time.perf_counter()])

    def lap(self) -> None:
        self._wait()
        self._clocks[-1].append(time.perf_counter())

    def text(self) -> str:
        counted = self._clocks[1:] or self._clocks
        render, noise, grids = 1e3 * np.median(np.diff(counted), axis=0)
        return f'rendered in {render:.0f} ms, noise in {noise:.0f} ms, two grids in {grids:.0f} ms'


def _table(grids: dict[str, np.ndarray]) -> Table:
    table = Table(
        title='height error in cells seen with and without noise, mm', box=box.HORIZONTALS
    )
    for heading in ('grid', 'cells seen', 'mean', 'median size', '95 %', 'RMS'):
        table.add_column(heading, justify='left' if heading == 'grid' else 'right')
    difference = grids['with noise'] - grids['without noise']
    both = np.isfinite(difference)
    for name, error in {**grids, 'with - without': difference}.items():
        seen = 1e3 * error[both] if both.any() else np.array([np.nan])
        size = np.abs(seen)
        table.add_row(
            name,
            f'{100 * np.isfinite(error).mean():.1f} %',
            f'{seen.mean():+.2f}',
            f'{np.median(size):.2f}',
            f'{np.percentile(size, 95):.1f}',
            f'{np.sqrt((size**2).mean()):.1f}',
        )
    return table


_EXTENT = (-0.35, 0.35, -0.55, 0.55)  # metres: left, right, behind, ahead of the grid


def draw(
    path: Path,
    clean: np.ndarray,
    noisy: np.ndarray,
    truth: np.ndarray,
    errors: dict[str, np.ndarray],
) -> None:
    """
    Draw the robot that stands on most steps, and the errors of all robots, as PNG.

    ``clean`` and ``noisy`` are (N, H, W) depth of the left cameras, 0 is invalid; ``truth`` and
    the ``errors`` of the grids are (N, rows, columns) heights, NaN where not seen; all in metres.
    """
    robot = int(np.argmax([len(np.unique(np.round(own, 2))) for own in truth]))
    own = f'robot {robot}'
    images = {f'{own}, left: clean': clean, f'{own}, left: with noise': noisy}
    depths = {title: np.where(one[robot] > 0, one[robot], np.nan) for title, one in images.items()}
    true, error = truth[robot], errors['with noise'][robot]
    heights = {f'{own}: true heights': true, f'{own}: seen with noise': true + error}
    limits = {'vmin': np.nanmin(true), 'vmax': np.nanmax(true) + 1e-3}
    wrong = {f'{own}: error {name}': 1e3 * one[robot] for name, one in errors.items()}
    change = 1e3 * (errors['with noise'] - errors['without noise'])
    spread = {'all robots: change by noise': np.sqrt(mean_of_valid(change**2))}
    with picture(path, 2, 4, figsize=(14, 7.2)) as (figure, axes):
        _draw(axes[0, :2], depths, 'depth [m]', 'turbo_r', vmin=0.3, vmax=4.0)
        for axis in axes[0, :2]:
            axis.set(xticks=[], yticks=[])
        _draw_grids(axes[0, 2:], heights, 'height [m]', 'viridis', **limits)
        _draw_grids(axes[1, :2], wrong, 'height error [mm]', 'RdBu', vmin=-20, vmax=20)
        _draw_grids(axes[1, 2:3], spread, 'RMS [mm]', 'magma')
        _draw_distribution(axes[1, 3], errors, np.isfinite(change))
        figure.suptitle(f'Height grids of {len(truth)} Go1 on stairs (gray: not seen)')


def _draw(
    axes: Any, images: dict[str, np.ndarray], label: str, colour_map: str, **style: Any
) -> None:
    # An image in each panel, by its title, and a bar of colours beside the last one.
    for axis, (title, image) in zip(axes, images.items(), strict=True):
        shown = axis.imshow(image, interpolation='nearest', cmap=colours(colour_map), **style)
        axis.set(title=title)
    axes[-1].figure.colorbar(shown, ax=axes[-1], label=label)


def _draw_grids(axes: Any, *shown: Any, **limits: Any) -> None:
    _draw(axes, *shown, origin='lower', extent=_EXTENT, **limits)
    for axis in axes:
        axis.set(xlabel='left [m]', ylabel='ahead [m]', xlim=_EXTENT[1::-1])


def _draw_distribution(axis: Any, errors: dict[str, np.ndarray], valid: np.ndarray) -> None:
    steps = np.geomspace(0.05, 300, 200)
    for name, error in errors.items():
        size = np.sort(1e3 * np.abs(error[valid]))
        axis.plot(steps, np.searchsorted(size, steps) / max(size.size, 1), label=name)
    axis.set(
        xscale='log',
        xlabel='absolute error [mm]',
        ylabel='fraction of cells below',
        title='all robots: height error',
        ylim=(0, 1),
    )
    axis.legend(loc='lower right')
    axis.grid(alpha=0.3)

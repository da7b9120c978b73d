"""`flexx2 batch`: many robots on stairs, their cameras in one batch, and height grids."""

import argparse
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros.atomic import checked_target, whole
from flexx2_sim_ros.cli.argument_types import SEEDS, whole_number
from flexx2_sim_ros.cli.common import add_profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import centred
from flexx2_sim_ros.profiles.files import find_profile
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

_MOST_WALKS = 256  # Walking is not batched: if there are more robots, several have the same walk.
_INTERVAL = 0.2  # seconds between the frames that go into the grid
_INVALID = '#3a3a3a'


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'batch',
        help='simulate the cameras of many robots at once, and draw their height grids',
        description='Simulate Go1 robots that walk over stairs, each with two cameras. All images '
        'get their noise in one batch (flexx2_sim_ros.batch) and are projected to the height '
        'grid around each robot (x +-0.5 m, y +-0.3 m, every 0.1 m). Prints and draws the '
        'errors of the grids with and without noise. Needs pip install "flexx2_sim_ros[batch]".',
        epilog='examples: flexx2 batch; on a GPU with mujoco-warp: flexx2 batch --num-envs 4096 '
        '--device cuda',
    )
    parser.add_argument(
        '--num-envs',
        type=whole_number(1, 1_000_000),
        default=64,
        help='number of robots (default %(default)s)',
    )
    parser.add_argument(
        '--frames',
        type=whole_number(1, 100_000),
        default=8,
        help=f'frames for each grid, {_INTERVAL} s apart (default %(default)s)',
    )
    add_profile(parser)
    parser.add_argument('--usecase', metavar='MODE', help="mode (default: the camera's usual one)")
    parser.add_argument(
        '--seed', type=whole_number(*SEEDS), default=0, help='seed of the noise (default 0)'
    )
    parser.add_argument('--device', help='cpu, cuda, cuda:1, ...; default: a GPU if there is one')
    parser.add_argument(
        '--renderer',
        default='auto',
        help='auto, mujoco-warp, egl, osmesa or ray (default %(default)s)',
    )
    parser.add_argument(
        '--out',
        type=Path,
        default=Path('height_grid.png'),
        help='picture to write (default %(default)s)',
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the example."""
    checked_target(arguments.out)
    profile = find_profile(arguments.profile)
    usecase = profile.mode(arguments.usecase or profile.default_usecase).name
    try:
        import warp as wp
    except ImportError as error:
        raise InputError(
            'warp-lang is not installed: pip install "flexx2_sim_ros[batch]"'
        ) from error
    wp.config.log_level = wp.LOG_WARNING
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
    cameras = [
        BatchCamera(
            count,
            usecase,
            profile=profile,
            seed=arguments.seed,
            name=name,
            K=intrinsics.matrix,
            device=arguments.device,
        )
        for name in names
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
    times = []
    with console.status('rendering, noise, grids (the first time compiles)'):
        for frame in range(arguments.frames):
            clock = [time.perf_counter()]

            def tick() -> None:
                wp.synchronize_device(device)
                clock.append(time.perf_counter())  # noqa: B023

            images = renderer.render(walks.qpos[frame, envs])
            tick()
            seen = [camera(image) for camera, image in zip(cameras, images, strict=True)]
            tick()
            for index in range(len(names)):
                pose = (
                    walks.camera_position[frame, envs, index],
                    walks.camera_rotation[frame, envs, index],
                )
                clean.add(images[index], *pose)
                noisy.add(seen[index], *pose)
            tick()
            times.append(np.diff(clock))
    truth = walks.heights[envs]
    grids = {
        'without noise': clean.heights().numpy() - truth,
        'with noise': noisy.heights().numpy() - truth,
    }
    render, noise, grid = 1e3 * np.median(times[1:] or times, axis=0)
    console.print(
        f'{count} robots with {len(names)} cameras, {arguments.frames} frames, '
        f'{cameras[0].usecases[0]}, on {device}, rendered by {renderer.backend}; '
        f'{count * len(names)} images: rendered in {render:.0f} ms, noise in '
        f'{noise:.0f} ms, two grids in {grid:.0f} ms',
        highlight=False,
    )
    console.print(_table(grids))
    _draw(arguments.out, images[0].numpy(), seen[0].numpy(), truth, grids)
    console.print(f'picture: {arguments.out}', highlight=False)
    return 0


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


def _draw(
    path: Path,
    clean: np.ndarray,
    seen: np.ndarray,
    truth: np.ndarray,
    grids: dict[str, np.ndarray],
) -> None:
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 4, figsize=(14, 7.2), layout='constrained')
    depths, heights, errors = (
        pyplot.get_cmap(name).with_extremes(bad=_INVALID)
        for name in ('turbo_r', 'viridis', 'RdBu')
    )
    one = int(np.argmax([len(np.unique(np.round(own, 2))) for own in truth]))  # on most steps
    for axis, image, title in zip(
        axes[0, :2], (clean[one], seen[one]), ('clean', 'with noise'), strict=True
    ):
        depth = axis.imshow(
            np.where(image > 0, image, np.nan),
            cmap=depths,
            vmin=0.3,
            vmax=4.0,
            interpolation='nearest',
        )
        axis.set(xticks=[], yticks=[], title=f'robot {one}, left: {title}')
    figure.colorbar(depth, ax=axes[0, 1], label='depth [m]')
    extent = (-0.35, 0.35, -0.55, 0.55)

    def show(axis: Any, image: np.ndarray, title: str, **how: Any) -> Any:
        shown = axis.imshow(image, origin='lower', extent=extent, interpolation='nearest', **how)
        axis.set(title=title, xlabel='left [m]', ylabel='ahead [m]', xlim=extent[1::-1])
        return shown

    low, high = np.nanmin(truth[one]), np.nanmax(truth[one]) + 1e-3
    for axis, image, title in (
        (axes[0, 2], truth[one], f'robot {one}: true heights'),
        (axes[0, 3], truth[one] + grids['with noise'][one], f'robot {one}: seen with noise'),
    ):
        shown = show(axis, image, title, cmap=heights, vmin=low, vmax=high)
    figure.colorbar(shown, ax=axes[0, 3], label='height [m]')
    for axis, (name, error) in zip(axes[1, :2], grids.items(), strict=True):
        shown = show(
            axis, 1e3 * error[one], f'robot {one}: error {name}', cmap=errors, vmin=-20, vmax=20
        )
    figure.colorbar(shown, ax=axes[1, 1], label='height error [mm]')
    difference = 1e3 * (grids['with noise'] - grids['without noise'])
    valid = np.isfinite(difference)
    spread = np.sqrt(
        np.divide(
            np.where(valid, difference**2, 0).sum(axis=0),
            valid.sum(axis=0),
            where=valid.any(axis=0),
            out=np.full(truth.shape[1:], np.nan),
        )
    )
    shown = show(
        axes[1, 2],
        spread,
        'all robots: change by noise',
        cmap=pyplot.get_cmap('magma').with_extremes(bad=_INVALID),
    )
    figure.colorbar(shown, ax=axes[1, 2], label='RMS [mm]')
    steps = np.geomspace(0.05, 300, 200)
    for name, error in grids.items():
        size = np.sort(1e3 * np.abs(error[valid]))
        axes[1, 3].plot(steps, np.searchsorted(size, steps) / max(size.size, 1), label=name)
    axes[1, 3].set(
        xscale='log',
        xlabel='absolute error [mm]',
        ylabel='fraction of cells below',
        title='all robots: height error',
        ylim=(0, 1),
    )
    axes[1, 3].legend(loc='lower right')
    axes[1, 3].grid(alpha=0.3)
    figure.suptitle(f'Height grids of {len(truth)} Go1 on stairs (gray: not seen)')
    with whole(path) as part:
        figure.savefig(part, dpi=100, format='png')
    pyplot.close(figure)

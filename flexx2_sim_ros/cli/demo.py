"""`flexx2 demo`: run the whole chain on real topics, measure it and draw a picture."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros.atomic import output_folder
from flexx2_sim_ros.cli.common import plain_table, progress_bar
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.cli.ros import camera_command, check, node_command, nodes, Processes, ros
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import centred, Reprojection
from flexx2_sim_ros.pictures import colours, picture
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import Mode, Profile
import numpy as np
from rich.console import Console
from rich.table import Table

Pictures = dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]
_CAMERAS = ['front_left', 'front_right']
_KINDS = 'clean', 'simulated', 'simulated - clean'
_START_SECONDS = 180.0
# How long to wait for frames of a mode, and how many: sigma needs three.
_FRAME_SECONDS, _FRAMES = 60.0, 3
OPTIONS = """
Start go1_cameras and two flexx2_camera nodes as processes, switch through the measured modes (all
modes, if none was measured) while they stream, print rates, latency and noise, and write a
picture. Needs ROS 2 (pip install "flexx2_sim_ros[ros]", or a sourced ROS 2 Jazzy).

--seconds SECONDS: how long to measure each mode (default %(default)s)
--out OUT: folder for the picture and the nodes' logs (default %(default)s)
--renderer RENDERER: auto, egl, osmesa or ray (default %(default)s)
--profile

example: flexx2 demo --seconds 5 --out demo_output
"""
VALUES = {
    'seconds': {'type': number(0, 1e6, above=True), 'default': 4.0},
    'out': {'type': Path, 'default': Path('demo_output')},
    'renderer': 'auto',
}


def run(arguments: argparse.Namespace) -> int:
    """Run the demo."""
    output_folder(arguments.out)
    profile = find_profile(arguments.profile)
    modes = [mode for mode in profile.modes if mode.measured] or list(profile.modes)
    console = Console(markup=False)
    # On a busy machine the numbers are wider and must not be cut off.
    console.width = max(console.width, 100)
    pictures: Pictures = {}
    table = _table()
    with ros() as stopped:
        from flexx2_sim_ros.nodes.probe import Probe

        probe = Probe(_CAMERAS)
        try:
            with (
                nodes(_commands(arguments), arguments.out) as processes,
                progress_bar(console) as progress,
            ):
                progress('starting three nodes (the first time compiles)', 0.0)
                _wait_for_streams(probe, processes, arguments.out, stopped)
                for mode in modes:
                    if stopped():
                        break
                    _measure(
                        probe,
                        mode.name,
                        arguments.seconds,
                        lambda: check(processes, arguments.out),
                        partial(progress, mode.name),
                        stopped,
                    )
                    if not stopped():
                        _keep(probe, mode.name, table, pictures)
        finally:
            probe.close()
    if stopped():
        return stopped.status
    console.print(table)
    console.print(
        'p50, p99: latency in ms, from the arrival of a clean image here to that of '
        'its\nsimulated one. inv.: invalid pixels in %. sigma: over time, root mean '
        'square over\nthe pixels away from edges, mm; model: what the noise model says '
        'of them.',
        style='dim',
    )
    path = arguments.out / 'demo.png'
    # On a busy machine a mode may lack frames.
    whole = [mode for mode in modes if all((name, mode.name) in pictures for name in _CAMERAS)]
    if not whole:
        raise InputError(f'no frame came; see the logs in {arguments.out}')
    draw(path, pictures, whole, profile)
    console.print(f'picture: {path}', highlight=False)
    return 0


def _measure(
    probe: Any,
    usecase: str,
    seconds: float,
    look_after: Callable[[], None],
    on_progress: Callable[[float], None],
    stopped: Callable[[], bool],
) -> None:
    probe.start(usecase)
    start = time.monotonic()
    while not stopped():
        passed = time.monotonic() - start
        enough = all(len(capture.stamps) >= _FRAMES for capture in probe.captures.values())
        if passed >= seconds and (enough or passed >= seconds + _FRAME_SECONDS):
            break
        look_after()
        probe.spin_until(stopped, 0.1)
        on_progress(min(passed / seconds, 1.0))


def _keep(probe: Any, usecase: str, table: Table, pictures: Pictures) -> None:
    for camera, capture in probe.captures.items():
        if capture.depth is None or capture.clean is None:
            table.add_row(camera, usecase, '0')
            continue
        pictures[camera, usecase] = (capture.clean, capture.depth)
        _add_row(table, camera, usecase, capture)


def _table() -> Table:
    text = 'camera', 'mode'
    names = *text, 'frames', 'Hz', 'p50', 'p99', 'inv.', 'sigma', 'model', 'ratio'
    return plain_table(*names, text=text, whole=names)


def _add_row(table: Table, camera: str, usecase: str, capture: Any) -> None:
    latency = sorted(1e3 * value for value in capture.latencies)
    realised, modelled = capture.sigmas()
    table.add_row(
        camera,
        usecase,
        str(len(capture.stamps)),
        f'{capture.rate_hz:.2f}',
        f'{latency[len(latency) // 2]:.1f}',
        f'{latency[int(0.99 * (len(latency) - 1))]:.1f}',
        f'{100 * capture.invalid_fraction:.1f}',
        f'{1e3 * realised:.2f}',
        f'{1e3 * modelled:.2f}',
        f'{realised / modelled:.3f}',
    )


def _commands(arguments: argparse.Namespace) -> dict[str, list[str]]:
    own = {'profile': arguments.profile} if arguments.profile else {}
    robot = node_command('go1_cameras', renderer=arguments.renderer, **own)
    return {'go1_cameras': robot} | {one: camera_command(one, **own) for one in _CAMERAS}


def _wait_for_streams(
    probe: Any, processes: Processes, folder: Path, stopped: Callable[[], bool]
) -> None:
    deadline = time.monotonic() + _START_SECONDS
    while not (stopped() or probe.spin_until(probe.streaming, 0.5)):
        check(processes, folder)
        if time.monotonic() > deadline:
            raise InputError(
                f'the nodes did not start streaming within {_START_SECONDS:g} s; see '
                f'the logs in {folder}'
            )


def draw(path: Path, pictures: Pictures, modes: list[Mode], profile: Profile) -> None:
    """
    Write the picture, PNG, with a row for each mode.

    ``pictures`` are clean depth as `go1_cameras` renders it for the profile, and simulated depth
    in the camera's pixels, by camera and mode; metres, NaN for invalid.
    """
    cameras = list(dict.fromkeys(camera for camera, _ in pictures))
    rows, columns = len(modes), 3 * len(cameras)
    size = 2.75 * columns + 1.6, 2.15 * rows + 0.7
    with picture(path, rows, columns, squeeze=False, figsize=size) as (figure, axes):
        for line, mode in zip(axes, modes, strict=True):
            for camera, three in zip(cameras, np.split(line, len(cameras)), strict=True):
                rendered, seen = pictures[camera, mode.name]
                depth, difference = _draw_three(three, as_seen(rendered, profile), seen)
            line[0].set_ylabel(
                f'{mode.name}\n{mode.range_min:g} to {mode.range_max:g} m\n'
                f'sigma_x {mode.noise.sigma_x:.2f} px',
                fontsize=11,
            )
        titles = [f'{one}: {kind}' for one in cameras for kind in _KINDS]
        for axis, title in zip(axes[0], titles, strict=True):
            axis.set_title(title, fontsize=11)
        ticks = [0.3, 0.5, 1, 2, 3, 5]
        bar = figure.colorbar(depth, ax=axes[:, -1], shrink=0.9, ticks=ticks, label='depth [m]')
        bar.ax.minorticks_off()
        bar.ax.set_yticklabels([f'{tick:g}' for tick in ticks])
        label = 'simulated - clean [mm]: red is nearer, blue farther'
        figure.colorbar(difference, ax=axes[:, -1], shrink=0.9, label=label)
        title = f'Two simulated {profile.model} on a Go1 (dark gray: no depth)'
        figure.suptitle(title, fontsize=13)


def _draw_three(axes: Any, clean: np.ndarray, seen: np.ndarray) -> tuple[Any, Any]:
    # Returns what the bars of colours are of: depth and difference.
    logarithmic = {'cmap': colours('turbo_r'), 'norm': 'log', 'vmin': 0.3, 'vmax': 5.0}
    linear = {'cmap': colours('RdBu'), 'vmin': -20, 'vmax': 20}
    images = (clean, logarithmic), (seen, logarithmic), (1e3 * (seen - clean), linear)
    for axis, (image, style) in zip(axes, images, strict=True):
        shown = axis.imshow(image, interpolation='nearest', **style)
        axis.set(xticks=[], yticks=[])
    return axes[1].images[0], shown


def as_seen(rendered: np.ndarray, profile: Profile) -> np.ndarray:
    """
    Return depth of the `centred` camera in the pixels of the camera, (H, W), NaN for invalid.

    A renderer has no distortion and the principal point in the middle, so for some cameras it
    draws a larger image.
    """
    camera = profile.intrinsics
    view = Reprojection(camera, centred(camera), sensor=profile.sensor)
    return np.where(view.outside, np.float32(np.nan), view.depth(rendered))

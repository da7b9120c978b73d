"""The cost of many cameras at once: on one core, and on a GPU where there is one."""

from collections.abc import Callable
from itertools import count
import time
from typing import Any

from bench.scenes import room
from bench.timing import one_core, side_by_side
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.batch.effect_tables import BATCHED
from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np
import warp as wp

_MODE = 'Mode_9_30fps'
_LARGE = ('time_offset', 'multipath', 'stray_light')  # effects on light of other pixels or times
_PERIOD = 33_333_333
_ON_GPU = (64, 1024, 8192)
_WANTED_SHARE = 0.25


def run(rounds: int = 20) -> None:
    """Print milliseconds, frames a second and ratios."""
    wp.config.log_level = wp.LOG_WARNING
    _cpu(64, rounds)
    if wp.is_cuda_available():
        _gpu(rounds)
    else:
        print('\non a GPU: no GPU here, nothing measured')


def _cpu(num_envs: int, rounds: int) -> None:
    scenes = np.stack([room(8 + i % 9) for i in range(num_envs)])
    matrix = flexx2().intrinsics.matrix
    single = Camera(_MODE, seed=1)
    batch = BatchCamera(num_envs, _MODE, device='cpu')
    offset = BatchCamera(num_envs, _MODE, effects={'offset': None}, device='cpu')
    everything = BatchCamera(num_envs, _MODE, effects=dict.fromkeys(BATCHED), device='cpu')
    moving = [scenes, scenes - np.float32(0.01)]
    large = {
        name: BatchCamera(num_envs, _MODE, effects={name: None}, device='cpu') for name in _LARGE
    }
    small = {name: Camera(_MODE, effects={name: None}, seed=1) for name in _LARGE}

    def one_by_one(camera: Camera) -> None:
        for i in range(num_envs):
            camera.capture(moving[next(turns) % 2][i], matrix, next(ticks) * _PERIOD)

    ticks, turns = count(), count()
    functions: dict[str, Callable[[], object]] = {
        'one': lambda: [single.capture(scene, matrix, next(ticks)) for scene in scenes],
        'batch': lambda: batch(scenes),
        'offset': lambda: offset(scenes),
        'everything': lambda: everything(scenes),
    }
    for name in _LARGE:
        functions[f'{name}, one'] = lambda name=name: one_by_one(small[name])  # type: ignore
        functions[f'{name}, batch'] = lambda name=name: large[name](  # type: ignore
            moving[next(turns) % 2]
        )
    torch = _torch()
    if torch:
        torch.set_num_threads(1)
        given = torch.from_numpy(scenes)
        functions['torch'] = lambda: plain_torch(torch, given, matrix)
    with one_core():
        times = side_by_side(functions, rounds, time.process_time)
    heading = f'{num_envs} frames of 224 x 172, one core, medians of CPU time'
    print(f'{heading:58s} ms / frame  / one at a time')
    for name, text in (
        ('one', 'one at a time, NumPy and numba (Camera)'),
        ('batch', 'at once (BatchCamera)'),
        ('offset', 'at once, one effect on (offset)'),
        ('everything', f'at once, {len(BATCHED)} effects on'),
        ('torch', 'plain torch: sigma(z, theta), pixels shifted row by row'),
    ):
        if name in times:
            print(f'{text:58s} {times[name] / num_envs:10.2f} {times[name] / times["one"]:16.2f}')
    for name in _LARGE:
        at_once, alone = times[f'{name}, batch'], times[f'{name}, one']
        text = f'at once, {name}, in scenes that move'
        print(f'{text:58s} {at_once / num_envs:10.2f} {at_once / alone:16.2f}')
    print('wanted: at once at most 1 x one at a time, each with the same effects')


def _gpu(rounds: int) -> None:
    device = wp.get_device('cuda')
    driver = '.'.join(map(str, wp.get_cuda_driver_version()))
    print(
        f'\n{device.name}, driver for CUDA {driver}, medians of captured graphs; copy: of the '
        'same frames from device memory to device memory'
    )
    print(f'{"N":>6s} {"frames/s":>10s} {"GB moved/s":>11s} {"/ copy":>7s} {"/ torch":>8s}')
    torch = _torch()
    for num_envs in _ON_GPU:
        with wp.ScopedDevice(device):
            scene = wp.array(room(), dtype=wp.float32)
            clean = wp.empty((num_envs, *scene.shape), dtype=wp.float32)
            for i in range(num_envs):
                wp.copy(clean[i], scene)
            camera = BatchCamera(num_envs, _MODE, device='cuda')
            target = wp.empty_like(clean)
            ours = _milliseconds(lambda: camera(clean), rounds)  # noqa: B023
            copying = _milliseconds(lambda: wp.copy(target, clean), rounds)  # noqa: B023
            plain = None
            if torch:
                given = wp.to_torch(clean)
                matrix = flexx2().intrinsics.matrix
                plain = _milliseconds(
                    lambda: plain_torch(torch, given, matrix),  # noqa: B023
                    rounds,
                    captured=False,
                )
        moved = 2 * clean.size * 4
        share = copying / ours
        note = '' if num_envs < max(_ON_GPU) or share >= _WANTED_SHARE else '  TOO SLOW'
        against = f'{ours / plain:8.3f}' if plain else f'{"no torch":>8s}'
        print(
            f'{num_envs:6d} {1e3 * num_envs / ours:10.0f} {moved / ours / 1e6:11.1f} '
            f'{share:7.2f} {against}{note}'
        )
    print(f'wanted: at N = {max(_ON_GPU)} at least {_WANTED_SHARE} of the rate of copying')


def _milliseconds(function: Callable[[], object], rounds: int, captured: bool = True) -> float:
    # Median on the device, by its own events; `captured` as one graph.
    function()
    if captured:
        with wp.ScopedCapture() as capture:
            function()
        graph = capture.graph

        def call() -> object:
            return wp.capture_launch(graph)
    else:
        call = function  # type: ignore[assignment]
    times = []
    for _ in range(rounds):
        start, end = (wp.Event(enable_timing=True) for _ in range(2))
        wp.record_event(start)
        call()
        if not captured:
            wp.synchronize_device()
        wp.record_event(end)
        times.append(wp.get_event_elapsed_time(start, end))
    return float(np.median(times))


def _torch() -> Any:
    try:
        import torch
    except ImportError:
        return None
    return torch


def plain_torch(torch: Any, depth: Any, matrix: np.ndarray) -> Any:
    """
    Add the noise as one writes it in an hour with torch: the yardstick for speed, not for truth.

    As `bench.straightforward`, but that a row's pixels are shifted alike, as an edge's are.
    """
    mode = flexx2().mode(_MODE)
    noise = mode.noise
    envs, height, width = depth.shape
    dzdv, dzdu = torch.gradient(depth, dim=(1, 2))
    theta = torch.atan(
        torch.hypot(dzdu * float(matrix[0, 0]) / depth, dzdv * float(matrix[1, 1]) / depth)
    ).clamp(max=1.48)
    sigma = (
        noise.a
        + noise.b * depth
        + noise.c * depth**2
        + noise.d * depth**noise.n * (theta / (np.pi / 2 - theta)) ** 2
    )
    shift = torch.round(torch.randn((envs, height, 1), device=depth.device) * noise.sigma_x)
    columns = torch.arange(width, device=depth.device) - shift.long()
    seen = torch.gather(depth, 2, columns.clamp(0, width - 1))
    out = seen + sigma * torch.randn_like(depth)
    return torch.where((out < mode.range_min) | (out > mode.range_max), torch.nan, out)

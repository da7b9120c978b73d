"""The cost of many cameras at once on a GPU, beside copying the frames there and plain torch."""

import gc
from unittest import mock

from bench.scenes import room
from flexx2_sim_ros.batch import BatchCamera, images
from flexx2_sim_ros.batch.effect_tables import BATCHED
from flexx2_sim_ros.camera import flexx2
import numpy as np
import warp as wp

_MODE = 'Mode_9_30fps'
_SIZES = (256, 1024, 8192)
_SCENES = 9
# Others than `batch.images` has.
_AT_A_TIME = (64, 128, 256, 1024)
_FOR_LISTED = (256, 512, 2048)
_WANTED = {'no effects': 1e6, 'all effects': 150e3}  # frames a second of the largest batch


def run(rounds=20):
    """Print frames a second, launches, and the share of the rate of copying."""
    wp.config.log_level = wp.LOG_WARNING
    if not wp.is_cuda_available():
        print('no GPU here, nothing measured')
        return
    device = wp.get_device('cuda')
    driver = '.'.join(map(str, wp.get_cuda_driver_version()))
    print(
        f'{device.name}, driver for CUDA {driver}; frames of 224 x 172 in scenes that move; a '
        f'step is one captured graph; medians of {rounds}; copy: of the same frames on the device'
    )
    print(
        f'{"effects":11s} {"N":>5s} {"ms a step":>9s} {"frames/s":>10s} {"launches":>8s} '
        f'{"copy, TB/s":>10s} {"/ copy":>6s} {"/ torch":>7s}'
    )
    largest = max(_SIZES)
    with wp.ScopedDevice(device):
        for name, wanted in _WANTED.items():
            for num_envs in _SIZES:
                _row(name, num_envs, rounds, wanted if num_envs == largest else 0.0)
        for count in _AT_A_TIME:
            print(f'\n{count} environments at a time')
            with mock.patch.dict(images.AT_A_TIME, cuda=count):
                for name in _WANTED:
                    _row(name, largest, rounds, 0.0)
        for threads in _FOR_LISTED:
            print(f'\n{threads} threads for the listed pixels of an environment')
            with mock.patch.object(images, 'THREADS_FOR_LISTED', threads):
                for name in _WANTED:
                    _row(name, largest, rounds, 0.0)


def _row(name, num_envs, rounds, wanted):
    gc.collect()  # The memory of the row before; several do not fit.
    torch, against = imported_torch(), 'none'
    if torch:
        torch.cuda.empty_cache()
    effects = dict.fromkeys(BATCHED) if name == 'all effects' else {}
    near, far = (_images(num_envs, step) for step in (0.0, 0.01))
    camera = BatchCamera(num_envs, _MODE, effects=effects, device='cuda')

    def steps():
        camera(near)
        camera(far)

    steps()
    with mock.patch.object(wp, 'launch', wraps=wp.launch) as launch:
        ours = milliseconds(steps, rounds) / 2
    launches = launch.call_count // 4  # Two steps, called and captured.
    copying = milliseconds(lambda: wp.copy(far, near), rounds)
    if torch:
        given, matrix = wp.to_torch(near), flexx2().intrinsics.matrix
        plain = milliseconds(lambda: plain_torch(torch, given, matrix), rounds, captured=False)
        against = f'{ours / plain:.3f}'
    print(
        f'{name:11s} {num_envs:5d} {ours:9.3f} {1e3 * num_envs / ours:10.0f} {launches:8d} '
        f'{8e-9 * near.size / copying:10.2f} {copying / ours:6.3f} {against:>7s}'
        f'{"" if 1e3 * num_envs / ours >= wanted else f"  TOO SLOW, wanted {wanted:.0f}"}',
        flush=True,
    )


def _images(num_envs, nearer):
    scenes = wp.array(np.stack([room(8 + i) for i in range(_SCENES)]) - np.float32(nearer))
    out = wp.empty((num_envs, *scenes.shape[1:]), dtype=wp.float32)
    for i in range(num_envs):
        wp.copy(out[i], scenes[i % _SCENES])
    return out


def milliseconds(function, rounds, captured=True):
    """Return the median on the device, by its own events; ``captured`` as one graph."""
    function()
    call = function
    if captured:
        with wp.ScopedCapture() as capture:
            function()
        call = lambda: wp.capture_launch(capture.graph)  # noqa: E731
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


def imported_torch():
    """Return torch, or None where it is not installed."""
    try:
        import torch
    except ImportError:
        return None
    return torch


def plain_torch(torch, depth, matrix):
    """
    Add the noise as one writes it in an hour with torch: the yardstick for speed, not for truth.

    Every pixel has sigma_z; a row's pixels are shifted alike, as an edge's are.
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

"""The camera model's cost a frame, against drawing two normals for each pixel; that of rays."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import count
import time

from bench.scenes import room
from bench.timing import one_core, side_by_side
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.robots.model import build_model, stand
import mujoco
import numpy as np

_STACK = 20  # frames, as in a recording of a diagnosis
_LARGE = 720, 1280


def run(rounds=400):
    """Print milliseconds and ratios."""
    scene, intrinsics = room(), flexx2().intrinsics
    matrix = intrinsics.matrix
    large = np.pad(scene, [(0, n - m) for n, m in zip(_LARGE, scene.shape, strict=True)], 'wrap')
    camera = Camera('Mode_9_30fps', seed=1)
    generator = np.random.default_rng(1)
    stamps = count()
    stack = np.repeat(scene[None], _STACK, 0)
    with one_core():
        times = side_by_side(
            {
                'NumPy, two normals a pixel (floor)': lambda: generator.standard_normal(
                    (2, *scene.shape)
                ),
                'this model': lambda: camera.capture(scene, matrix, next(stamps)),
                f'the same, {_STACK} frames at once': lambda: camera.capture(
                    stack, matrix, np.arange(_STACK)
                ),
                'large': lambda: camera.capture(large, matrix, next(stamps)),
            },
            rounds,
            time.process_time,
        )
    cost = 1e6 * times.pop('large') / large.size
    *_, stacked = times
    times[stacked] /= _STACK
    floor, *_ = times.values()
    print(f'{"a 224 x 172 frame, one core, median CPU time":46s}      ms  / floor')
    for name, milliseconds in times.items():
        print(f'{name:46s} {milliseconds:7.2f} {milliseconds / floor:8.2f}')
    print('wanted: / floor at most 2.5')
    print(f'a frame of 1280 x 720: {cost:.1f} ns a pixel; wanted: at most 9.2')
    _threads(scene, matrix, rounds)
    _rays(intrinsics, rounds // 10)


def _threads(scene, matrix, rounds):
    # The same frames by one thread and by two, each with a camera of its own; on idle cores.
    cameras = [Camera('Mode_9_30fps', seed=seed) for seed in (1, 2)]

    def look(camera):
        for stamp in range(_STACK):
            camera.capture(scene, matrix, stamp)

    with ThreadPoolExecutor(2) as pool:
        times = side_by_side(
            {
                'one': lambda: [look(camera) for camera in cameras],
                'two': lambda: list(pool.map(look, cameras)),
            },
            max(rounds // _STACK, 1),
        )
    print(
        f'two threads with a camera each: {times["one"] / times["two"]:.2f} times the frames of '
        'one thread; wanted: at least 1.8'
    )


def _rays(intrinsics, rounds):
    # A standing Go1 in the lab.
    model = build_model(intrinsics=intrinsics)
    data = mujoco.MjData(model)
    stand(model, data)
    mujoco.mj_forward(model, data)
    renderer = open_renderer(model, intrinsics, 'ray')
    times = side_by_side(
        {name: partial(renderer.render, data, name) for name in ('front_left', 'front_right')},
        max(rounds, 1),
        time.process_time,
    )
    print(
        f'rays for one camera of a Go1: {max(times.values()):.1f} ms of a core; wanted: at most 8'
    )

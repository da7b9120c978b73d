"""The camera model's cost a frame, on one core, against drawing two normals for each pixel."""

from itertools import count
import time

from bench.scenes import room
from bench.timing import one_core, side_by_side
from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np

_STACK = 20  # frames, as in a recording of a diagnosis


def run(rounds=400):
    """Print milliseconds and ratios."""
    scene, matrix = room(), flexx2().intrinsics.matrix
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
            },
            rounds,
            time.process_time,
        )
    *_, stacked = times
    times[stacked] /= _STACK
    floor, *_ = times.values()
    print(f'{"a 224 x 172 frame, one core, median CPU time":46s}      ms  / floor')
    for name, milliseconds in times.items():
        print(f'{name:46s} {milliseconds:7.2f} {milliseconds / floor:8.2f}')
    print('wanted: / floor at most 2.5')

"""The camera model's cost a frame, against a floor and a plain implementation; in two threads."""

from concurrent.futures import ThreadPoolExecutor
from itertools import count
import time

from bench.scenes import room
from bench.timing import one_core, peak_megabytes, side_by_side
from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np

_STACK = 20  # frames, as in a recording of a diagnosis
_LARGE = 720, 1280


def straightforward(depth, fx, fy, mode, generator):
    """
    Add sigma_z(z, theta) after shifting every pixel by a Gaussian offset of its own.

    Measured by the procedure of the paper, its edges move too little and its slanted surfaces are
    too noisy.
    """
    noise = mode.noise
    height, width = depth.shape
    dzdv, dzdu = np.gradient(depth)
    theta = np.arctan(np.hypot(dzdu * fx / depth, dzdv * fy / depth))
    theta = np.minimum(theta, np.float32(1.48))
    sigma = (
        noise.a
        + noise.b * depth
        + noise.c * depth**2
        + noise.d * depth ** np.float32(noise.n) * (theta / (np.pi / 2 - theta)) ** 2
    )
    shift = np.rint(generator.standard_normal((height, width), np.float32) * noise.sigma_x)
    columns = np.clip(np.arange(width) - shift.astype(np.int32), 0, width - 1)
    seen = np.take_along_axis(depth, columns, axis=1)
    out = seen + sigma * generator.standard_normal((height, width), np.float32)
    out[(out < mode.range_min) | (out > mode.range_max)] = np.nan
    return out


def run(rounds=400):
    """Print milliseconds and ratios."""
    profile = flexx2()
    scene = room()
    camera = Camera('Mode_9_30fps', seed=1)
    matrix = profile.intrinsics.matrix
    generator = np.random.default_rng(1)
    stamps = count()
    stack = np.repeat(scene[None], _STACK, 0)
    large = np.pad(scene, [(0, n - m) for n, m in zip(_LARGE, scene.shape, strict=True)], 'wrap')
    with one_core():
        times = side_by_side(
            {
                'floor': lambda: generator.standard_normal((2, *scene.shape)),
                'floor32': lambda: generator.standard_normal((2, *scene.shape), np.float32),
                'plain': lambda: straightforward(
                    scene, matrix[0, 0], matrix[1, 1], camera.mode, generator
                ),
                'model': lambda: camera.capture(scene, matrix, next(stamps)),
                'stack': lambda: camera.capture(stack, matrix, np.arange(_STACK)),
                'large': lambda: camera.capture(large, matrix, next(stamps)),
            },
            rounds,
            time.process_time,
        )
    times['stack'] /= _STACK
    rows = (
        ('NumPy, two float64 normals a pixel (floor)', 'floor'),
        ('NumPy, two float32 normals a pixel', 'floor32'),
        ('straightforward NumPy sigma(z, theta) + shifted pixels', 'plain'),
        ('this model: normals, axial, lateral', 'model'),
        (f'the same, a frame of {_STACK} at once', 'stack'),
    )
    print(f'{"a 224 x 172 frame, one core, median CPU time":56s}      ms  / floor  / plain')
    for text, name in rows:
        print(
            f'{text:56s} {times[name]:7.2f} {times[name] / times["floor"]:8.2f} '
            f'{times[name] / times["plain"]:8.2f}'
        )
    print(f'wanted: / floor at most 2.5, / plain at most 1; peak memory {peak_megabytes():.0f} MB')
    cost = 1e6 * times['large'] / large.size
    print(f'a frame of 1280 x 720: {cost:.1f} ns a pixel; wanted: at most 9.2')
    _threads(scene, matrix, rounds)


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

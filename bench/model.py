"""The camera model's cost a frame, on one core, against a floor and a plain implementation."""

from itertools import count

from bench.scenes import room
from bench.straightforward import straightforward
from bench.timing import one_core, peak_megabytes, side_by_side
from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np


def run(rounds: int = 400) -> None:
    """Print milliseconds and ratios."""
    profile = flexx2()
    scene = room()
    camera = Camera('Mode_9_30fps', seed=1)
    matrix = profile.intrinsics.matrix
    generator = np.random.default_rng(1)
    stamps = count()
    with one_core():
        times = side_by_side(
            {
                'floor': lambda: generator.standard_normal((2, *scene.shape)),
                'floor32': lambda: generator.standard_normal((2, *scene.shape), np.float32),
                'plain': lambda: straightforward(
                    scene, matrix[0, 0], matrix[1, 1], camera.mode, generator
                ),
                'model': lambda: camera.capture(scene, matrix, next(stamps)),
            },
            rounds,
        )
    rows = (
        ('NumPy, two float64 normals a pixel (floor)', 'floor'),
        ('NumPy, two float32 normals a pixel', 'floor32'),
        ('straightforward NumPy sigma(z, theta) + shifted pixels', 'plain'),
        ('this model: normals, axial, lateral', 'model'),
    )
    print(f'{"a 224 x 172 frame, one core, medians":56s}      ms  / floor  / plain')
    for text, name in rows:
        print(
            f'{text:56s} {times[name]:7.2f} {times[name] / times["floor"]:8.2f} '
            f'{times[name] / times["plain"]:8.2f}'
        )
    print(f'wanted: / floor at most 2.5, / plain at most 1; peak memory {peak_megabytes():.0f} MB')

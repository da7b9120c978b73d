"""The cost of every effect a frame, on one core, relative to the base model in the same run."""

from itertools import count
import time

from bench.scenes import room
from bench.timing import one_core, side_by_side
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import registry
import numpy as np

_PERIOD = 33_333_333
# Whatever is not here may cost three times the base model.
_ALLOWED = {'multipath': 10.0, 'stray_light': 10.0}


def run(rounds=60):
    """Print milliseconds a frame and ratios, in the mode with two frequencies."""
    names = list(registry())
    with one_core():
        times = side_by_side(
            {
                'base': _frames({}),
                **{name: _frames({name: None}) for name in names},
                'multipath, first frame': _frames({'multipath': None}, fresh=True),
                'all': _frames(dict.fromkeys(names)),
            },
            rounds,
            time.process_time,
        )
    base = times['base']
    print(
        'a frame of 224 x 172 in Mode_9_30fps, one core, medians of CPU time; base model '
        f'{base:.2f} ms'
    )
    print(f'{"effect":24s}     ms  / base  allowed')
    for name in [*names, 'multipath, first frame']:
        allowed = _ALLOWED.get(name.split(',')[0], 3.0)
        note = '' if times[name] <= allowed * base else '  TOO SLOW'
        print(f'{name:24s} {times[name]:6.2f} {times[name] / base:7.2f} {allowed:8.0f}{note}')
    print(
        f'all {len(names)} on: {times["all"]:.2f} ms, {1e3 / times["all"]:.0f} frames/s; '
        'wanted: at least 15'
    )


def _frames(effects, fresh=False):
    # A scene that comes nearer, so that effects of motion have something to do; but one that
    # stands still for what is kept of a scene, unless `fresh`.
    camera = Camera('Mode_9_30fps', effects=effects, seed=1)
    scene = room()
    generator = np.random.default_rng(1)
    reflectivity = generator.uniform(0.2, 0.9, scene.shape).astype(np.float32)
    matrix = flexx2().intrinsics.matrix
    still = list(effects) == ['multipath'] and not fresh
    scenes = [scene if still else scene - np.float32(0.01 * i) for i in range(2)]
    ticks = count()

    def frame():
        tick = next(ticks)
        return camera.capture(scenes[tick % 2], matrix, tick * _PERIOD, reflectivity)

    return frame

"""The cost of every effect a frame, on one core, relative to the base model in the same run."""

from functools import partial
import time

from bench.scenes import frames_of
from bench.timing import one_core, side_by_side
from flexx2_sim_ros.effects import registry

# Whatever is not here may cost three times the base model.
_ALLOWED = {'multipath': 10.0, 'stray_light': 10.0}


def run(rounds=60):
    """Print milliseconds a frame and ratios, in the mode with two frequencies."""
    names = list(registry())
    frames = partial(frames_of, 'Mode_9_30fps')
    functions = {'base': frames({}), **{name: frames({name: None}) for name in names}}
    # What is kept of a scene counts for one that stands still.
    functions['multipath, first frame'] = functions['multipath']
    functions['multipath'] = frames({'multipath': None}, still=True)
    functions['all'] = frames(dict.fromkeys(names))
    with one_core():
        times = side_by_side(functions, rounds, time.process_time)
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

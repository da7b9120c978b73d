"""The cost of many cameras at once on a CPU: on one core, and on all."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import count
from operator import call
import os
from pathlib import Path
import resource
import time

from bench.scenes import room
from bench.timing import one_core, side_by_side
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.batch.effect_tables import BATCHED
from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np
import warp as wp

_MODE = 'Mode_9_30fps'
_EVERYTHING = 'all effects'
# Alone: a simple effect, and those on light of other pixels or times.
_ALONE = ('offset', 'time_offset', 'multipath', 'stray_light', 'motion_artefact')
_KEEPING = (*_ALONE[1:], 'temporal_filter', 'fixed_pattern')
# A loop at 50 Hz, whose images arrive after 60 ms: every call computes a frame.
_LATE = 'step_s, delay'
_STEP_S, _DELAYED = 1 / 50, {'time_offset': {'latency': 0.0, 'delay': 0.06}}
_KEPT_ENVS = 256
_PERIOD = 33_333_333


def run(rounds=20):
    """Print milliseconds, frames a second, ratios, and memory."""
    wp.config.log_level = wp.LOG_WARNING
    _cpu(64, rounds)
    _threads(64, rounds)
    _memory()


def _cpu(num_envs, rounds):
    scenes = np.stack([room(8 + i % 9) for i in range(num_envs)])
    matrix = flexx2().intrinsics.matrix
    moving = [scenes, scenes - np.float32(0.01)]
    sets = {
        'no effects': {},
        _LATE: _DELAYED,
        **{name: {name: None} for name in _ALONE},
        _EVERYTHING: dict.fromkeys(BATCHED),
    }
    ticks, turns = count(), count()

    def one_by_one(camera):
        now = moving[next(turns) % 2]
        for scene in now:
            camera.capture(scene, matrix, next(ticks) * _PERIOD)

    functions = {}
    for name, effects in sets.items():
        alone = Camera(_MODE, effects=effects, seed=1)
        step_s = _STEP_S if name == _LATE else None
        batch = BatchCamera(num_envs, _MODE, effects=effects, step_s=step_s, device='cpu')
        functions[f'{name}, one'] = partial(one_by_one, alone)
        functions[f'{name}, batch'] = lambda batch=batch: batch(moving[next(turns) % 2])
    with one_core():
        times = side_by_side(functions, rounds, time.process_time)
    print(
        f'{num_envs} frames of 224 x 172 in scenes that move, one core, medians of CPU time in '
        'milliseconds a frame'
    )
    print(f'{"effects":16s} Camera  BatchCamera  / Camera')
    for name in sets:
        one, many = (times[f'{name}, {how}'] / num_envs for how in ('one', 'batch'))
        note = '' if many <= one else '  TOO SLOW'
        print(f'{name:16s} {one:6.2f} {many:12.2f} {many / one:9.2f}{note}')
    print('wanted: / Camera at most 1')


def _threads(num_envs, rounds):
    # The environments divided among threads, each with a camera of its own.
    scenes = np.stack([room(8 + i % 9) for i in range(num_envs)])
    cores = len(os.sched_getaffinity(0))
    functions = {}
    with ThreadPoolExecutor(cores) as pool:
        for number in sorted({1, 2, cores}):
            parts = np.array_split(scenes, number)
            cameras = [BatchCamera(len(part), _MODE, device='cpu') for part in parts]
            functions[str(number)] = partial(_call_all, pool, cameras, parts)
        elapsed = side_by_side(functions, rounds)
        used = side_by_side(functions, rounds, time.process_time)
    print(f'\n{num_envs} frames without effects, {cores} cores, medians')
    print('threads  ms a frame  / 1 thread  CPU ms a frame')
    for name, milliseconds in elapsed.items():
        print(
            f'{name:>7s} {milliseconds / num_envs:11.2f} {milliseconds / elapsed["1"]:11.2f} '
            f'{used[name] / num_envs:15.2f}'
        )


def _call_all(pool, cameras, parts):
    list(pool.map(call, cameras, parts))


def _memory():
    # What is kept of an environment: of the process, all cameras kept, beyond an effect that keeps
    # nothing.
    clean = np.repeat(room()[None], _KEPT_ENVS, axis=0)
    shades = np.full_like(clean, 0.5)
    cameras, taken = [], {}
    for name in (_EVERYTHING, 'offset', *_KEEPING, 'time_offset, reflectivity'):
        # The first one compiles.
        effects = BATCHED if name == _EVERYTHING else (name.split(',')[0],)
        before = _resident()
        camera = BatchCamera(_KEPT_ENVS, _MODE, effects=dict.fromkeys(effects), device='cpu')
        camera(clean, shades if ',' in name else None)
        cameras.append(camera)
        taken[name] = (_resident() - before) / _KEPT_ENVS
    print(f'\nmemory of the process, MB for each of {_KEPT_ENVS} environments beyond offset')
    for name in (*_KEEPING, 'time_offset, reflectivity'):
        print(f'{name:26s} {taken[name] - taken["offset"]:6.2f}')


def _resident():
    # MB.
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * resource.getpagesize() / 1e6

"""Frames and their times, asked for line by line: the processes of `bench.versions`."""

from functools import partial
from itertools import count
from pathlib import Path
import sys
import tempfile
import time

from bench.scenes import frames_of, moving
from bench.timing import one_core
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.effects import registry
import numpy as np
import warp as wp

_ENVS = 8
_COMPARED_MODES = 'Mode_9_30fps', 'Mode_5_30fps'
_COMPARED_FRAMES = 4


def main():
    """Answer ``cases``, ``time`` and ``frames`` (a case each, after a tab) until input ends."""
    wp.config.log_level = wp.LOG_ERROR
    makers = dict(_makers())
    running = {}
    with one_core(), tempfile.TemporaryDirectory() as folder:
        for line in sys.stdin:
            what, case = line.rstrip('\n').split('\t')
            if what == 'cases':
                answer = '\t'.join(makers)
            elif what == 'time':
                if case not in running:
                    running[case] = makers[case]('Mode_9_30fps')
                start = time.process_time()
                running[case]()
                answer = str(time.process_time() - start)
            else:
                answer = str(Path(folder) / 'frames.npy')
                np.save(answer, _frames(makers[case]))
            print(answer, flush=True)


def _makers():
    # What makes, for a mode, a function that returns one frame after the other.
    names = list(registry())
    sets = {'no effects': {}, **{name: {name: None} for name in names}}
    for name, effects in {**sets, 'all effects': dict.fromkeys(names)}.items():
        yield f'Camera: {name}', partial(_one, effects)
        yield f'BatchCamera: {name}', partial(_many, effects)


def _one(effects, mode):
    frame = frames_of(mode, effects)
    return lambda: frame().depth


def _many(effects, mode):
    camera = BatchCamera(_ENVS, mode, effects=effects, seed=1, device='cpu')
    (scenes, shades), ticks = moving(), count()
    depth = [np.repeat(scene[None], _ENVS, axis=0) for scene in scenes]
    reflectivity = np.repeat(shades[None], _ENVS, axis=0)

    def frames():
        return camera(depth[next(ticks) % 2], reflectivity)

    return frames


def _frames(make):
    made = []
    for mode in _COMPARED_MODES:
        look = make(mode)
        made += [look().copy() for _ in range(_COMPARED_FRAMES)]
    return np.stack(made)


if __name__ == '__main__':
    main()

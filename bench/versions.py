"""
Compare the frames of this version with those of another one: their time and their depths.

The other version is a Git revision. Its package runs in a process of its own, this one's in
another, and the two take turns on one core. Effects that only one of them has are left out.
``BatchCamera`` makes 8 frames at a time; its times are for all 8.

python -m bench.versions REVISION
python -m bench.versions REVISION --cases 'Camera: multipath,BatchCamera: multipath' --rounds 60
"""

import argparse
from contextlib import ExitStack
from functools import partial
import io
from itertools import count
from pathlib import Path
import shutil
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time

from bench.scenes import frames_of, moving
from bench.timing import one_core
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.effects import registry
import numpy as np
import warp as wp

_BENCH = Path(__file__).resolve().parent
_SAME = 1e-6  # metres
_ENVS = 8
_COMPARED_MODES = 'Mode_9_30fps', 'Mode_5_30fps'
_COMPARED_FRAMES = 4


def main():
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description='Compare the frames of two versions.')
    parser.add_argument('revision', help='the other version, e.g. HEAD~1')
    parser.add_argument('--cases', default='', help='separated by commas; default: all')
    parser.add_argument('--rounds', type=int, default=40)
    arguments = parser.parse_args()
    with ExitStack() as stack:
        tree = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        _export(arguments.revision, tree)
        before, after = (stack.enter_context(_Version(folder)) for folder in (tree, _BENCH.parent))
        theirs = before.ask('cases').split('\t')
        cases = [case for case in after.ask('cases').split('\t') if case in theirs]
        if arguments.cases:
            cases = [case for case in cases if case in arguments.cases.split(',')]
        print('224 x 172 pixels, Mode_9_30fps, one core; medians of CPU time in milliseconds')
        print(
            f'{"":32s}  before   after  / before   largest difference (m)   pixels beyond '
            f'{_SAME:g} m'
        )
        for case in cases:
            _compare(case, before, after, arguments.rounds)


def _compare(case, before, after, rounds):
    times = {before: [], after: []}
    for turn in range(rounds + 2):
        for version, taken in times.items():
            seconds = float(version.ask('time', case))
            if turn >= 2:  # The first ones compile and allocate.
                taken.append(1e3 * seconds)
    old, new = (statistics.median(taken) for taken in times.values())
    largest, beyond = _difference(*(np.load(one.ask('frames', case)) for one in times))
    print(
        f'{case:32s} {old:7.2f} {new:7.2f} {new / old:9.2f} {largest:24.1e} {beyond:22d}',
        flush=True,
    )


def _difference(before, after):
    # In pixels that both see; and how many differ by more than `_SAME`, or in validity.
    seen = np.isfinite(before)
    apart = np.abs(np.where(seen & np.isfinite(after), before - after, 0))
    return float(apart.max()), int(((apart > _SAME) | (seen != np.isfinite(after))).sum())


def _export(revision, tree):
    # The other version's package, with the measurements of this one.
    archive = subprocess.run(
        ['git', 'archive', revision, 'flexx2_sim_ros', 'config'],
        cwd=_BENCH.parent,
        check=True,
        stdout=subprocess.PIPE,
    ).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(tree, filter='data')
    shutil.copytree(_BENCH, tree / 'bench')


class _Version:
    # A process that runs the package in a folder.

    def __init__(self, folder):
        self._process = subprocess.Popen(
            [sys.executable, '-c', 'from bench.versions import answer; answer()'],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.wait()

    def ask(self, what, case=''):
        self._process.stdin.write(f'{what}\t{case}\n')
        self._process.stdin.flush()
        answer = self._process.stdout.readline().rstrip('\n')
        if not answer:
            raise SystemExit(f'{what} {case}: the process ended')
        return answer


def answer():
    """Answer ``cases``, ``time`` and ``frames`` (a case each, after a tab) until input ends."""
    wp.config.log_level = wp.LOG_ERROR
    makers = dict(_makers())
    running = {}
    with one_core(), tempfile.TemporaryDirectory() as folder:
        for line in sys.stdin:
            what, case = line.rstrip('\n').split('\t')
            if what == 'cases':
                said = '\t'.join(makers)
            elif what == 'time':
                if case not in running:
                    running[case] = makers[case]('Mode_9_30fps')
                start = time.process_time()
                running[case]()
                said = str(time.process_time() - start)
            else:
                said = str(Path(folder) / 'frames.npy')
                np.save(said, _frames(makers[case]))
            print(said, flush=True)


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

"""
How accuracy, confidence and time change with recordings, frames, pose error and resolution.

Blind cameras with one effect of half the typical strength, or none, are diagnosed. One quantity is
changed at a time; the others keep the values of `USUAL`. Each camera has the same seeds at all
points of a curve, but other numbers of recordings and frames are other scenes and noise.
Development seeds only. One line of JSON is written for each diagnosis; an interrupted run resumes.
An effect's curves are finished before those of the next one begin.

python -m bench.gap_curves --seeds 900,901 --minutes 15
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
import time
from typing import Any

from bench.journal import Journal
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT
from flexx2_sim_ros.validation.benchmark.design import MODES, Planned
from flexx2_sim_ros.validation.benchmark.goals import confidences
from flexx2_sim_ros.validation.benchmark.scoring import Answer, answer_of, share
from flexx2_sim_ros.validation.blind import BlindCamera
import numpy as np

USUAL: dict[str, float] = {'recordings': 8, 'frames': 12, 'pose_mm': 2.0, 'width': 112}
CURVES: dict[str, tuple[float, ...]] = {
    'recordings': (2, 4, 8, 16, 32),
    'frames': (1, 3, 12, 30, 100),
    'pose_mm': (0.0, 2.0, 5.0, 10.0),
    'width': (56, 112, 224),
}
# One each that changes noise, edges, bias, invalid pixels and frames one after the other.
_EFFECTS = 'excess_noise,none,multipath,temporal_filter,low_signal_dropout,flying_pixels'
_KEPT = 'verdict', 'effects', 'alternatives', 'gap'
_NOTHING = {'affected': np.zeros(0, bool), 'samples': np.zeros((0, 0))}  # no places are scored


def main() -> None:
    """Diagnose what is missing, and print a line for each point of each curve."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--curves', default=','.join(CURVES), help='names, separated by commas')
    parser.add_argument('--effects', default=_EFFECTS)
    parser.add_argument('--strength', type=float, default=0.5)
    parser.add_argument('--seeds', default='900')
    parser.add_argument('--minutes', type=float, default=1e9, help='then stop; resumes later')
    parser.add_argument('--out', type=Path, default=Path('build/gap_curves.jsonl'))
    arguments = parser.parse_args()
    journal = Journal(arguments.out, usual=USUAL, strength=arguments.strength)
    began = time.monotonic()
    done = [line['planned'] for line in journal]
    for planned in _cases(arguments):
        if planned.to_json() in done:
            continue
        if time.monotonic() - began > 60 * arguments.minutes:
            break
        journal.add(_line(planned))
        done.append(planned.to_json())
        print(*planned.effects, _point(planned), flush=True)
    _print(list(journal), arguments.curves.split(','))


def _cases(arguments: argparse.Namespace) -> Iterator[Planned]:
    for seed in map(int, arguments.seeds.split(',')):
        for name in arguments.effects.split(','):
            effects = {} if name == 'none' else {name: arguments.strength}
            for curve in arguments.curves.split(','):
                for value in CURVES[curve]:
                    yield _planned(seed, effects, {**USUAL, curve: value})


def _planned(seed: int, effects: dict[str, float], point: dict[str, float]) -> Planned:
    return Planned(
        'single' if effects else 'none',
        MODES[seed % 2],
        effects,
        DEVELOPMENT.seed(1000 + seed),
        DEVELOPMENT.seed(seed),
        pose_mm=point['pose_mm'],
        width=int(point['width']),
        height=round(point['width'] * 172 / 224),
        recordings=int(point['recordings']),
        frames=int(point['frames']),
    )


def _point(planned: Planned) -> dict[str, float]:
    return {name: getattr(planned, name) for name in USUAL}


def _line(planned: Planned) -> dict[str, Any]:
    with scratch_folder() as folder:
        BlindCamera(planned.case).record(folder)
        began = time.process_time()
        table = diagnose(folder, seed=planned.seed)
    return {
        'planned': planned.to_json(),
        'diagnosis': {key: table[key] for key in _KEPT},
        'seconds': table['seconds'],
        'cpu_seconds': round(time.process_time() - began, 2),
    }


def _print(lines: Sequence[dict[str, Any]], curves: Sequence[str]) -> None:
    answers = [answer_of(Planned.from_json(x['planned']), x, {}, _NOTHING) for x in lines]
    print(
        '\n| | | named first | wrong | named or an alternative | false alarms | confidence: mean, '
        'present | s of a core |'
    )
    print('|---|---:|---:|---:|---:|---:|---:|---:|')
    for curve in curves:
        for value in CURVES[curve]:
            point = {**USUAL, curve: value}
            some = [a for a in answers if _point(a.planned) == point]
            if some:
                print(f'| {curve} | {value:g} | {" | ".join(_cells(some))} |')


def _cells(answers: Sequence[Answer]) -> Iterator[str]:
    present = [a for a in answers if a.planned.effects]
    none = [a for a in answers if not a.planned.effects]
    for some, counts in (
        (present, lambda a: a.right),
        (present, lambda a: a.wrong),
        (present, lambda a: a.covers),
        (none, lambda a: not a.right),
    ):
        hits, count = share(some, counts)
        yield f'{hits} of {count}' if count else '-'
    pairs = np.array(confidences(answers))
    yield ', '.join(f'{mean:.2f}' for mean in pairs.mean(axis=0)) if len(pairs) else '-'
    yield f'{np.median([a.cpu_seconds for a in answers]):.1f}'


if __name__ == '__main__':
    main()

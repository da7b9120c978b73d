"""
How accuracy, confidence and time change with recordings, frames, pose error and resolution.

Blind cameras with one effect of half the typical strength, or none, are diagnosed. One quantity is
changed at a time; the others keep the values of `USUAL`. Poses that are wrong by 10 mm count as a
`pose_error`. Each camera has the same seeds at all points of a curve, but other numbers of
recordings and frames are other scenes and noise. Development seeds only. One line of JSON is
written for each diagnosis; an interrupted run resumes. An effect's curves are finished before
those of the next one begin. ``--picture`` draws the curves.

python -m bench.gap_curves --seeds 900,901 --minutes 15
python -m bench.gap_curves --seeds 900,901 --picture docs/curves.png
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from bench.decision_fit import POSE_IS_AN_EFFECT
from bench.journal import Journal
from flexx2_sim_ros.atomic import scratch_folder, whole
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT
from flexx2_sim_ros.validation.benchmark.design import MODES, Planned
from flexx2_sim_ros.validation.benchmark.goals import confidences
from flexx2_sim_ros.validation.benchmark.scoring import Answer, answer_of, share, wilson
from flexx2_sim_ros.validation.blind import BlindCamera
import matplotlib as mpl
from matplotlib.figure import Figure
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
_LABELS = {
    'recordings': 'recordings',
    'frames': 'frames of each',
    'pose_mm': 'pose error, mm',
    'width': 'width of the image, px',
}
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
    parser.add_argument('--picture', type=Path)
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
    lines, curves = list(journal), arguments.curves.split(',')
    answers = [answer_of(_true(Planned.from_json(x['planned'])), x, {}, _NOTHING) for x in lines]
    _print(answers, curves)
    if arguments.picture:
        _draw(answers, curves, arguments.picture)


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


def _true(planned: Planned) -> Planned:
    # As in `bench.decision_fit`: poses that are so wrong are an effect to be named.
    if planned.pose_mm <= POSE_IS_AN_EFFECT:
        return planned
    return replace(planned, group='single', effects={**planned.effects, 'pose_error': 1.0})


def _print(answers: Sequence[Answer], curves: Sequence[str]) -> None:
    print(
        '\n| | | named first | wrong | named or an alternative | false alarms | confidence: mean, '
        'present | s of a core |'
    )
    print('|---|---:|---:|---:|---:|---:|---:|---:|')
    for curve in curves:
        for value in CURVES[curve]:
            some = _at(answers, curve, value)
            if some:
                print(f'| {curve} | {value:g} | {" | ".join(_cells(some))} |')


def _at(answers: Sequence[Answer], curve: str, value: float) -> list[Answer]:
    point = {**USUAL, curve: value}
    return [one for one in answers if _point(one.planned) == point]


def _draw(answers: Sequence[Answer], curves: Sequence[str], path: Path) -> None:
    # Rates with 95 % intervals, calibration of the confidence, and time, against each quantity.
    with mpl.rc_context({'font.size': 8}):
        figure = Figure(figsize=(2.4 * len(curves), 5.6), layout='constrained')
        rows = figure.subplots(3, len(curves), sharex='col', sharey='row', squeeze=False)
        for k, curve in enumerate(curves):
            points = [(x, _at(answers, curve, x)) for x in CURVES[curve]]
            _draw_curve(rows[:, k], [(x, some) for x, some in points if some])
            rows[2, k].set(xlabel=_LABELS[curve], ylim=(0, None))
            if curve != 'pose_mm':
                rows[2, k].set_xscale('log', base=2)
                rows[2, k].set_xticks(CURVES[curve], [f'{x:g}' for x in CURVES[curve]])
                rows[2, k].minorticks_off()
        for row, label in zip(rows[:, 0], ('rate', 'rate', 'seconds of a core'), strict=True):
            row.set_ylabel(label)
        for row, place in zip(rows[:2, 0], ('center left', 'lower left'), strict=True):
            row.set_ylim(-0.03, 1.03)
            row.legend(fontsize=7, loc=place)
        with whole(path) as part:
            figure.savefig(part, dpi=130, format='png')


def _draw_curve(axes: np.ndarray, points: Sequence[tuple[float, list[Answer]]]) -> None:
    places = [x for x, _ in points]
    for label, effect, counts, color in (
        ('named first', True, lambda a: a.right, 'C0'),
        ('false alarms', False, lambda a: not a.right, 'C3'),
    ):
        rates = [share([a for a in some if bool(a.truth) == effect], counts) for _, some in points]
        for x, (hits, count) in zip(places, rates, strict=True):
            if count:
                axes[0].plot([x, x], wilson(hits, count), color=color, lw=1, alpha=0.5)
        means = [hits / count if count else np.nan for hits, count in rates]
        axes[0].plot(places, means, 'o-', color=color, ms=3, label=label)
    pairs = [np.array(confidences(some)).reshape(-1, 2).mean(axis=0) for _, some in points]
    for label, values, color in zip(
        ('mean confidence', 'named effects that are present'),
        np.transpose(pairs),
        ('0.5', 'C0'),
        strict=True,
    ):
        axes[1].plot(places, values, 'o-', color=color, ms=3, label=label)
    axes[2].plot(
        places, [np.median([a.cpu_seconds for a in some]) for _, some in points], 'o-k', ms=3
    )


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

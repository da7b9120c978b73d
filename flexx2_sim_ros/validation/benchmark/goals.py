"""The goals of the benchmark, and which of them the scores reach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.validation.benchmark.scoring import Answer, Scores, share
from flexx2_sim_ros.validation.benchmark.sheets import mean, percent, Sheet
import numpy as np


@dataclass(frozen=True)
class _Goal:
    # A goal on the fraction of `answers` for which `counts` holds.
    what: str
    wanted: str
    answers: Sequence[Answer]
    counts: Callable[[Answer], bool]
    reached: Callable[[float], bool]

    def row(self) -> tuple[str, ...]:
        found, total = share(self.answers, self.counts)
        reached = None if not total else self.reached(found / total)
        return self.what, self.wanted, percent(found, total), _yes(reached)


def _yes(reached: bool | None) -> str:
    return '-' if reached is None else 'yes' if reached else 'NO'


def reach(scores: Scores) -> Sheet:
    """Return the table of the goals at the usual pose error, and which are reached."""
    usual = Scores(
        tuple(answer for answer in scores.answers if answer.planned.pose_mm == 2.0),
        scores.commitment,
    )
    checked = [
        answer
        for answer in usual.answers
        if not math.isnan(answer.realised) and not math.isnan(answer.predicted)
    ]
    singles = [*usual.of('single', strength=1.0), *usual.of('single', strength=0.5)]
    coverage = _Goal(
        'predicted reduction: empirical coverage of 90 % intervals',
        '85-95 %',
        checked,
        lambda a: a.low <= a.realised <= a.high,
        lambda s: 0.85 <= s <= 0.95,
    )
    rows = [
        *(goal.row() for goal in _verdict_goals(usual, singles)),
        _mean_row(
            'localisation of single effects: mean IoU',
            '0.6',
            [a.overlap for a in singles if not math.isnan(a.overlap)],
            lambda value: value >= 0.6,
        ),
        _mean_row(
            'predicted reduction of the gap: mean absolute error',
            '<= 0.06',
            [abs(a.predicted - a.realised) for a in checked],
            lambda value: value <= 0.06,
        ),
        coverage.row(),
        *_cost_rows(scores.answers),
    ]
    return Sheet('Goals', ('what', 'goal', 'result', 'reached'), rows)


def _verdict_goals(usual: Scores, singles: Sequence[Answer]) -> list[_Goal]:
    def right(answer: Answer) -> bool:
        return answer.right

    return [
        _Goal(
            'single effects, strength 1: correct',
            '95 %',
            usual.of('single', strength=1.0),
            right,
            lambda s: s >= 0.95,
        ),
        _Goal(
            'single effects, strength 0.5: correct',
            '85 %',
            usual.of('single', strength=0.5),
            right,
            lambda s: s >= 0.85,
        ),
        _Goal(
            '... wrong: missed, or another effect named',
            '< 3 %',
            singles,
            lambda a: a.wrong,
            lambda s: s < 0.03,
        ),
        _Goal(
            'no effect: false alarms',
            '<= 3 %',
            usual.of('none'),
            lambda a: not a.right,
            lambda s: s <= 0.03,
        ),
        _Goal(
            'effects outside the catalogue: unknown or partly',
            '90 %',
            usual.of('novel'),
            right,
            lambda s: s >= 0.9,
        ),
        _Goal(
            'true effect removed from the catalogue: unknown or partly',
            '80 %',
            usual.of('left_out'),
            right,
            lambda s: s >= 0.8,
        ),
        _Goal(
            'cameras with unknown internals: correct',
            '90 %',
            usual.of('internals'),
            right,
            lambda s: s >= 0.9,
        ),
        _Goal(
            'two effects: one of them named first',
            '95 %',
            usual.of('pair'),
            right,
            lambda s: s >= 0.95,
        ),
        _Goal(
            'two effects: both named',
            '85 %',
            usual.of('pair'),
            lambda a: a.both,
            lambda s: s >= 0.85,
        ),
    ]


def _mean_row(
    what: str, wanted: str, values: Sequence[float], reached: Callable[[float], bool]
) -> tuple[str, ...]:
    result = None if not values else reached(float(np.mean(values)))
    return what, wanted, mean(values), _yes(result)


def _cost_rows(answers: Sequence[Answer]) -> list[tuple[str, ...]]:
    seconds = [a.seconds for a in answers]
    slowest = max(seconds)
    peak = [a.peak_mb for a in answers if not math.isnan(a.peak_mb)]
    return [
        (
            'time of one diagnosis, median / slowest',
            '< 30 s',
            f'{np.median(seconds):.1f} / {slowest:.1f} s',
            _yes(slowest < 30),
        ),
        (
            'memory of one diagnosis, largest',
            '< 2 GB',
            f'{max(peak):.0f} MB' if peak else '-',
            _yes(max(peak) < 2000 if peak else None),
        ),
    ]

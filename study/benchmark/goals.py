"""The goals of the benchmark, and which of them the scores reach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from study.benchmark.reliability import calibration_error, Pairs
from study.benchmark.scoring import Answer, NONE, Scores, share
from study.benchmark.sheets import known, percent, Sheet

USUAL_POSE_MM = 2.0
_MOST_SECONDS = 15.0
_MOST_MB = 1000.0
# By the number of effects: what is named, and the reduction that is realised.
_MANY = {4: (0.95, 0.8), 8: (0.85, 0.75), 14: (0.7, 0.65)}


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
        return self.what, self.wanted, percent(found, total, '.1f'), _yes(reached)


@dataclass(frozen=True)
class _Number:
    # A goal on a statistic of `values`, none of which is NaN.
    what: str
    wanted: str
    values: Sequence[Any]
    statistic: Callable[[Sequence[Any]], float]
    reached: Callable[[float], bool]
    form: str = '.3f'

    def row(self) -> tuple[str, ...]:
        if not self.values:
            return self.what, self.wanted, '-', _yes(None)
        value = float(self.statistic(self.values))
        shown = f'{value:{self.form}} ({len(self.values)})'
        return self.what, self.wanted, shown, _yes(self.reached(value))


def _yes(reached: bool | None) -> str:
    return '-' if reached is None else 'yes' if reached else 'NO'


def reach(scores: Scores) -> Sheet:
    """Return the table of the goals, and which are reached."""
    goals = [
        *_verdict_goals(scores),
        *_place_goals(scores),
        *_reduction_goals(scores),
        *_many_goals(scores),
        *_confidence_goals(scores),
        *_cost_goals(scores.answers),
    ]
    return Sheet('Goals', ('what', 'goal', 'result', 'reached'), [goal.row() for goal in goals])


def confidences(answers: Sequence[Answer]) -> Pairs:
    """Return the confidence of each named effect, and whether the effect is present."""
    return [
        (confidence, name in answer.truth)
        for answer in answers
        for name, confidence in zip(answer.effects, answer.confidences, strict=True)
        if not math.isnan(confidence)
    ]


def _singles(scores: Scores, *strengths: float) -> list[Answer]:
    # At the usual pose error.
    return [
        answer
        for strength in strengths
        for answer in scores.of('single', strength=strength, pose_mm=USUAL_POSE_MM)
    ]


def _verdict_goals(scores: Scores) -> list[_Goal]:
    def right(answer: Answer) -> bool:
        return answer.right

    def alarm(answer: Answer) -> bool:
        return not answer.right

    full, both = _singles(scores, 1.0), _singles(scores, 1.0, 0.5)
    none, far = (scores.of('none', pose_mm=pose) for pose in (USUAL_POSE_MM, 5.0))
    novel, out = scores.of('novel'), scores.of('left_out')
    inside, pairs = scores.of('internals'), scores.of('pair')
    return [
        _Goal('single effects, strength 1: correct', '>= 98 %', full, right, _least(0.98)),
        _Goal(
            'single effects, strength 0.5: correct',
            '>= 85 %',
            _singles(scores, 0.5),
            right,
            _least(0.85),
        ),
        _Goal('cameras with unknown internals: correct', '>= 90 %', inside, right, _least(0.9)),
        _Goal(
            'single effects, strengths 1 and 0.5, wrong: missed, or another effect named',
            '< 3 %',
            both,
            lambda a: a.wrong,
            lambda s: s < 0.03,
        ),
        _Goal('no effect, poses wrong by 2 mm: false alarms', '<= 3 %', none, alarm, _most(0.03)),
        _Goal('no effect, poses wrong by 5 mm: false alarms', '<= 5 %', far, alarm, _most(0.05)),
        _Goal(
            'effects outside the catalogue: unknown or partly',
            '>= 95 %',
            novel,
            right,
            _least(0.95),
        ),
        _Goal(
            'true effect removed from the catalogue: unknown or partly',
            '>= 95 %',
            out,
            right,
            _least(0.95),
        ),
        _Goal('two effects: one of them named first', '>= 95 %', pairs, right, _least(0.95)),
        _Goal('two effects: both named', '>= 85 %', pairs, lambda a: a.both, _least(0.85)),
    ]


def _place_goals(scores: Scores) -> list[_Goal | _Number]:
    singles = _singles(scores, 1.0, 0.5)
    return [
        _Goal(
            'first row of `where` names a covariate that the effect depends on',
            '>= 90 %',
            [a for a in singles if a.place],
            lambda a: a.right_place,
            _least(0.9),
        ),
        _Number(
            'localisation of single effects: mean IoU',
            '>= 0.6',
            known([a.overlap for a in singles]),
            np.mean,
            _least(0.6),
        ),
    ]


def _reduction_goals(scores: Scores) -> list[_Goal | _Number]:
    full = [a.realised for a in _singles(scores, 1.0) if a.independent]
    checked = [a for a in scores.answers if not math.isnan(a.prediction_error)]
    return [
        _Number(
            'realised reduction of the gap, strength 1, independent measure: median',
            '>= 0.85',
            full,
            np.median,
            _least(0.85),
        ),
        _Number('... the smallest', '>= 0', full, min, _least(0.0)),
        _Number(
            'predicted less realised reduction: mean absolute value',
            '<= 0.06',
            [a.prediction_error for a in checked],
            np.mean,
            _most(0.06),
        ),
        _Goal(
            'predicted reduction: empirical coverage of 90 % intervals',
            '85-95 %',
            checked,
            lambda a: a.interval_holds,
            lambda s: 0.85 <= s <= 0.95,
        ),
    ]


def _many_goals(scores: Scores) -> list[_Goal | _Number]:
    goals: list[_Goal | _Number] = []
    for count, (named, gone) in _MANY.items():
        some = [a for a in scores.of('many') if len(a.truth) == count]
        goals += [
            _Number(
                f'{count} effects: named, weighted by what they contribute: mean',
                f'>= {named}',
                [a.recall for a in some],
                np.mean,
                _least(named),
            ),
            _Number(
                f'{count} effects: realised reduction, median',
                f'>= {gone}',
                [a.delivered for a in some],
                np.median,
                _least(gone),
            ),
        ]
    many = scores.of('many')
    return [
        *goals,
        _Number(
            'many effects: wrong names a camera',
            '<= 0.1',
            [a.wrong_names for a in many],
            np.mean,
            _most(0.1),
        ),
        _Number(
            'many effects: rank correlation of what is taken off with the truth',
            '>= 0.8',
            known([a.order for a in many]),
            np.mean,
            _least(0.8),
        ),
        _Goal(
            'many effects: depth error in mm grows',
            'never',
            [a for a in many if not math.isnan(a.after_mm)],
            lambda a: a.after_mm > a.before_mm,
            _most(0.0),
        ),
    ]


def _confidence_goals(scores: Scores) -> list[_Goal | _Number]:
    said = confidences(scores.answers)
    reported = [a for a in _singles(scores, 1.0, 0.5) if a.verdict not in (NONE, 'error')]
    return [
        _Number(
            'expected calibration error of `confidence`, all cases',
            '<= 0.05',
            said,
            calibration_error,
            _most(0.05),
        ),
        _Goal(
            'single effects with a reported gap: the true one is named or an alternative',
            '>= 90 %',
            reported,
            lambda a: a.covers,
            _least(0.9),
        ),
    ]


def _cost_goals(answers: Sequence[Answer]) -> list[_Number]:
    answers = [a for a in answers if a.planned.group != 'many']
    cpu, elapsed = known([a.cpu_seconds for a in answers]), [a.seconds for a in answers]
    quick = f'<= {_MOST_SECONDS:.0f} s'
    return [
        _Number(
            'one diagnosis on one core, computing time: median',
            quick,
            cpu,
            np.median,
            _most(_MOST_SECONDS),
            '.1f',
        ),
        _Number('... the slowest', quick, cpu, max, _most(_MOST_SECONDS), '.1f'),
        _Number(
            '... elapsed time, with all that the machine did: median',
            quick,
            elapsed,
            np.median,
            _most(_MOST_SECONDS),
            '.1f',
        ),
        _Number(
            'memory of the process, largest, MB',
            '< 1 GB',
            known([a.peak_mb for a in answers]),
            max,
            lambda value: value < _MOST_MB,
            '.0f',
        ),
    ]


def _least(limit: float) -> Callable[[float], bool]:
    return lambda value: value >= limit


def _most(limit: float) -> Callable[[float], bool]:
    return lambda value: value <= limit

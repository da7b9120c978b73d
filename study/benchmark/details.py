"""Tables of single effects: what goes away, where `where` points, and how sure the names are."""

from collections.abc import Sequence
import math

import numpy as np
from study.benchmark.goals import confidences, USUAL_POSE_MM
from study.benchmark.physics import covariate_of, DEPENDS_ON
from study.benchmark.reliability import bins, calibration_error, least_calibration_error
from study.benchmark.scoring import Answer, SAID, Scores, share
from study.benchmark.sheets import known, mean, most_common, percent, Sheet

_STRENGTHS = 1.0, 0.5  # of which fresh scenes are recorded, and places are counted


def reductions(scores: Scores) -> Sheet:
    """Return how much of the gap really goes away in fresh scenes, by effect and strength."""
    rows = []
    for name in DEPENDS_ON:
        for strength in _STRENGTHS:
            planned = [a for a in _cases(scores, name, strength) if a.planned.realise]
            some = [a for a in planned if not math.isnan(a.realised)]
            held, count = share(some, lambda a: a.interval_holds)
            if planned:
                rows.append(
                    (
                        name,
                        f'{strength:g}',
                        ', '.join(
                            f'{a.realised:.2f}{"" if a.independent else " *"}' for a in some
                        ),
                        ', '.join(f'{a.predicted:.2f}' for a in some),
                        f'{held}/{count}' if count else '-',
                        f'{len(planned) - count}',
                    )
                )
    return Sheet(
        'Realised reduction of the gap in fresh scenes, by effect (*: the gap is below the '
        "tolerance in depth and invalid pixels; by the diagnosis's own measure)",
        ('effect', 'strength', 'realised', 'predicted', 'interval holds', 'not measured'),
        rows,
    )


def together(scores: Scores) -> Sheet:
    """Return what is found of many effects at once, by their number and the size of images."""
    rows = []
    many = scores.of('many')
    for count, width in sorted({(len(a.truth), a.planned.width) for a in many}):
        some = [a for a in many if (len(a.truth), a.planned.width) == (count, width)]
        measured = [a for a in some if not math.isnan(a.after_mm)]
        held, checked = share(measured, lambda a: a.interval_holds)
        rows.append(
            (
                f'{count}, {width} px',
                f'{len(some)}',
                *(
                    mean([getattr(a, name) for a in some]).split(' ')[0]
                    for name in ('recall', 'wrong_names', 'predicted', 'delivered')
                ),
                mean([a.prediction_error for a in some]).split(' ')[0],
                f'{held}/{checked}',
                f'{share(measured, lambda a: a.after_mm > a.before_mm)[0]}',
                mean([a.order for a in some]).split(' ')[0],
                mean([a.cpu_seconds for a in some], '.0f').split(' ')[0],
            )
        )
    return Sheet(
        'Many effects at once, strengths 0.25 to 2, other internals: means over cameras',
        (
            *('effects', 'cameras', 'named', 'wrong names', 'predicted', 'realised'),
            *('difference', 'interval holds', 'worse in mm', 'order', 'seconds'),
        ),
        rows,
    )


def first_places(scores: Scores) -> Sheet:
    """Return how often the first row of ``where`` names what an effect depends on."""
    rows = []
    for name, covariates in DEPENDS_ON.items():
        groups = [_cases(scores, name, strength) for strength in _STRENGTHS]
        groups.append([a for a in scores.of('left_out') if list(a.planned.effects) == [name]])
        shown = [[a for a in group if a.place] for group in groups]
        others = [covariate_of(a.place) for some in shown for a in some if not a.right_place]
        if any(groups):
            cells = (_hits(some) for some in shown)
            rows.append((name, ', '.join(covariates), *cells, most_common(others)))
    return Sheet(
        'First row of `where`: names a covariate that the effect depends on, of the cases with '
        'a row',
        (
            'effect',
            'depends on',
            *(f'strength {strength:g}' for strength in _STRENGTHS),
            'left out',
            'most common other covariate',
        ),
        rows,
    )


def _cases(scores: Scores, name: str, strength: float) -> list[Answer]:
    singles = scores.of('single', strength=strength, pose_mm=USUAL_POSE_MM)
    return [a for a in singles if list(a.planned.effects) == [name]]


def _hits(answers: Sequence[Answer]) -> str:
    hits, count = share(answers, lambda a: a.right_place)
    return f'{hits}/{count}' if count else '-'


def reliability(scores: Scores) -> Sheet:
    """Return how often named effects are present, by their confidence."""
    pairs = confidences(scores.answers)
    rows = [
        (
            f'{low:.1f} to {high:.1f}',
            f'{np.mean([said for said, _ in some]):.2f}',
            percent(sum(true for _, true in some), len(some)),
        )
        for low, high, some in bins(pairs)
    ]
    error, chance = calibration_error(pairs), least_calibration_error(pairs)
    return Sheet(
        'Confidence of named effects, in all cases '
        f'(expected calibration error {error:.3f}; true probabilities: {chance:.3f} by chance)',
        ('confidence', 'mean', 'present'),
        rows,
    )


def reduction_summary(scores: Scores) -> Sheet:
    """Return the realised reduction and the errors of the prediction, by case and by verdict."""
    groups = {
        **{f'single, strength {s:g}': scores.of('single', strength=s) for s in _STRENGTHS},
        'pair': scores.of('pair'),
        **{
            f'verdict {name}': [one for one in scores.answers if one.verdict == name]
            for name in SAID
        },
    }
    rows = []
    for name, answers in groups.items():
        some = [a for a in answers if not math.isnan(a.realised)]
        mine = [a.realised for a in some if a.independent]
        errors = known([a.prediction_error for a in some])
        if some:
            rows.append(
                (
                    name,
                    f'{len(some)}, {len(some) - len(mine)}',
                    f'{np.median(mine):.2f}' if mine else '-',
                    f'{min(mine):.2f}' if mine else '-',
                    f'{np.mean(errors):.2f}, {np.median(errors):.2f}' if errors else '-',
                    percent(*share(some, lambda a: a.interval_holds)),
                )
            )
    return Sheet(
        'Realised and predicted reduction (*: see the next table; not in median and smallest)',
        (
            'cases',
            'measured, of these *',
            'realised: median',
            'smallest',
            'error of predicted: mean, median',
            'interval holds',
        ),
        rows,
    )

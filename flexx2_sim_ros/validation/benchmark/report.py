"""The benchmark's result: a table in the terminal, a page, a picture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from pathlib import Path

from flexx2_sim_ros.atomic import whole, write_text
from flexx2_sim_ros.validation.benchmark.design import STRENGTHS
from flexx2_sim_ros.validation.benchmark.scoring import (
    Answer,
    f1_pairs,
    macro_f1,
    NONE,
    Scores,
    share,
    UNKNOWN,
    wilson,
)
from flexx2_sim_ros.validation.blind import CATALOGUE, NOVEL
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Sheet:
    """A table: title, column names, rows of text."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


def sheets(scores: Scores) -> list[Sheet]:
    """Return all tables of a run."""
    return [_reach(scores), _groups(scores), _effects(scores), _baselines(scores)]


def print_report(scores: Scores, console: Console) -> None:
    """Print the tables."""
    for sheet in sheets(scores):
        table = Table(title=sheet.title, box=box.SIMPLE_HEAD, title_justify='left')
        for place, name in enumerate(sheet.columns):
            table.add_column(name, justify='right' if place else 'left', no_wrap=not place)
        for row in sheet.rows:
            table.add_row(*row)
        console.print(table)


def write_page(scores: Scores, path: Path, command: str, picture: str) -> None:
    """
    Write the tables as Markdown.

    Parameters
    ----------
    scores : Scores
        Of a finished run.
    path : pathlib.Path
        The page.
    command : str
        What was run.
    picture : str
        File name of the confusion picture, beside the page.

    """
    facts = scores.commitment
    lines = [
        '# Benchmark of the diagnosis',
        '',
        "The diagnosis was tested on a camera whose physics is separate from the simulator's "
        '([blind_camera.md](blind_camera.md)). Brackets are 95 % Wilson intervals.',
        '',
        f'`{command}`, {facts["date"]}, {facts["seed_set"]} seeds, '
        f'version {facts["version"]}, {_cases(scores)}; the labels were sealed before '
        f'the run (SHA-256 `{facts["sha256"]}`).',
        '',
    ]
    for sheet in sheets(scores):
        lines += [
            f'## {sheet.title}',
            '',
            '| ' + ' | '.join(sheet.columns) + ' |',
            '|' + '|'.join('---' if not k else '---:' for k in range(len(sheet.columns))) + '|',
        ]
        lines += ['| ' + ' | '.join(row) + ' |' for row in sheet.rows] + ['']
    lines += ['## Confusion matrix', '', f'![confusion]({picture})', '']
    write_text(path, '\n'.join(lines))


def _cases(scores: Scores) -> str:
    done, planned = len(scores.answers), scores.commitment['cases']
    if done == planned:
        return f'{done} cases'
    return f'the first {done} of {planned} cases (in the sealed, random order)'


def draw_confusion(scores: Scores, path: Path) -> None:
    """Write a PNG of the confusion matrix over all strengths, as fractions of each row."""
    from matplotlib import pyplot

    truths = [*sorted(CATALOGUE), *sorted(NOVEL), NONE]
    answers = [*sorted(CATALOGUE), UNKNOWN, NONE, 'error']
    counts = np.zeros((len(truths), len(answers)))
    for answer in scores.answers:
        if answer.planned.group in ('single', 'none', 'novel'):
            said = 'error' if answer.verdict == 'error' else answer.first
            # The answer may name what the catalogue here does not have; that is wrong as well.
            column = answers.index(said) if said in answers else len(answers) - 1
            counts[truths.index(next(iter(answer.planned.effects), NONE)), column] += 1
    rows = counts.sum(axis=1) > 0
    shown = counts[rows] / counts[rows].sum(axis=1, keepdims=True)
    figure, axes = pyplot.subplots(figsize=(11, 0.27 * rows.sum() + 2.4), layout='constrained')
    image = axes.imshow(shown, cmap='Blues', vmin=0, vmax=1, aspect='auto')
    axes.set_xticks(range(len(answers)), answers, rotation=60, ha='right')
    axes.set_yticks(
        range(len(shown)),
        [
            f'{name} ({int(n)})'
            for name, n, keep in zip(truths, counts.sum(axis=1), rows, strict=True)
            if keep
        ],
    )
    for y, x in zip(*np.nonzero(shown), strict=True):
        axes.text(
            x,
            y,
            f'{100 * shown[y, x]:.0f}',
            ha='center',
            va='center',
            fontsize=7,
            color='white' if shown[y, x] > 0.6 else 'black',
        )
    axes.set_xlabel('first answer')
    axes.set_ylabel('truth (cases)')
    figure.colorbar(image, label='fraction of the row', shrink=0.6)
    with whole(path) as part:
        figure.savefig(part, dpi=100, format='png')
    pyplot.close(figure)


def _percent(hits: int, count: int) -> str:
    if not count:
        return '-'
    low, high = wilson(hits, count)
    return f'{100 * hits / count:.0f} % [{100 * low:.0f}-{100 * high:.0f}] of {count}'


def _mean(values: Sequence[float], form: str = '.2f') -> str:
    known = [value for value in values if not math.isnan(value)]
    return f'{np.mean(known):{form}} ({len(known)})' if known else '-'


def _reach(scores: Scores) -> Sheet:
    # The goals of the project, at the usual pose error.
    usual = Scores(
        tuple(answer for answer in scores.answers if answer.planned.pose_mm == 2.0),
        scores.commitment,
    )
    singles = [*usual.of('single', strength=1.0), *usual.of('single', strength=0.5)]
    rows = [
        *_answer_goals(usual, singles),
        _overlap_goal(singles),
        *_prediction_goals(usual),
        *_cost_goals(scores),
    ]
    return Sheet('Goals', ('what', 'goal', 'result', 'reached'), rows)


def _goal(
    what: str, wanted: str, count: tuple[int, int], holds: Callable[[float], bool]
) -> tuple[str, ...]:
    reached = '-' if not count[1] else 'yes' if holds(count[0] / count[1]) else 'NO'
    return what, wanted, _percent(*count), reached


def _answer_goals(usual: Scores, singles: Sequence[Answer]) -> list[tuple[str, ...]]:
    return [
        _goal(
            'single effects, strength 1: correct',
            '95 %',
            share(usual.of('single', strength=1.0), lambda a: a.right),
            lambda s: s >= 0.95,
        ),
        _goal(
            'single effects, strength 0.5: correct',
            '85 %',
            share(usual.of('single', strength=0.5), lambda a: a.right),
            lambda s: s >= 0.85,
        ),
        _goal(
            '... wrong: missed, or another effect named',
            '< 3 %',
            share(singles, lambda a: a.wrong),
            lambda s: s < 0.03,
        ),
        _goal(
            'no effect: false alarms',
            '<= 3 %',
            share(usual.of('none'), lambda a: not a.right),
            lambda s: s <= 0.03,
        ),
        _goal(
            'effects outside the catalogue: unknown or partly',
            '90 %',
            share(usual.of('novel'), lambda a: a.right),
            lambda s: s >= 0.9,
        ),
        _goal(
            'true effect removed from the catalogue: unknown or partly',
            '80 %',
            share(usual.of('left_out'), lambda a: a.right),
            lambda s: s >= 0.8,
        ),
        _goal(
            'two effects: one of them named first',
            '95 %',
            share(usual.of('pair'), lambda a: a.right),
            lambda s: s >= 0.95,
        ),
        _goal(
            'two effects: both named',
            '85 %',
            share(usual.of('pair'), lambda a: a.both),
            lambda s: s >= 0.85,
        ),
    ]


def _overlap_goal(singles: Sequence[Answer]) -> tuple[str, ...]:
    overlaps = [a.overlap for a in singles if not math.isnan(a.overlap)]
    return (
        'localisation of single effects: mean IoU',
        '0.6',
        _mean(overlaps),
        '-' if not overlaps else 'yes' if np.mean(overlaps) >= 0.6 else 'NO',
    )


def _prediction_goals(usual: Scores) -> list[tuple[str, ...]]:
    checked = [
        answer
        for answer in usual.answers
        if not math.isnan(answer.realised) and not math.isnan(answer.predicted)
    ]
    off = [abs(answer.predicted - answer.realised) for answer in checked]
    return [
        (
            'predicted reduction of the gap: mean absolute error',
            '<= 0.06',
            _mean(off),
            '-' if not off else 'yes' if np.mean(off) <= 0.06 else 'NO',
        ),
        _goal(
            'predicted reduction: empirical coverage of 90 % intervals',
            '85-95 %',
            share(checked, lambda a: a.low <= a.realised <= a.high),
            lambda s: 0.85 <= s <= 0.95,
        ),
    ]


def _cost_goals(scores: Scores) -> list[tuple[str, ...]]:
    seconds = [a.seconds for a in scores.answers]
    slowest = max(seconds)
    peak = [a.peak_mb for a in scores.answers if not math.isnan(a.peak_mb)]
    return [
        (
            'time of one diagnosis, median / slowest',
            '< 30 s',
            f'{np.median(seconds):.1f} / {slowest:.1f} s',
            'yes' if slowest < 30 else 'NO',
        ),
        (
            'memory of one diagnosis, largest',
            '< 2 GB',
            f'{max(peak):.0f} MB' if peak else '-',
            '-' if not peak else 'yes' if max(peak) < 2000 else 'NO',
        ),
    ]


def _row(name: str, answers: Sequence[Answer]) -> tuple[str, ...]:
    return (
        name,
        _percent(*share(answers, lambda a: a.right)),
        *(
            f'{share(answers, of)[0]}'
            for of in (
                lambda a: a.contains and not a.right,
                lambda a: a.verdict == UNKNOWN,
                lambda a: a.wrong,
                lambda a: a.missed,
                lambda a: not a.visible,
            )
        ),
        _mean([a.overlap for a in answers]),
        _mean([a.parameter_error for a in answers]),
    )


def _groups(scores: Scores) -> Sheet:
    modes = sorted({a.planned.usecase for a in scores.answers})
    poses = sorted({a.planned.pose_mm for a in scores.answers})
    rows = [
        _row(f'single, strength {strength:g}', scores.of('single', strength=strength, pose_mm=2.0))
        for strength in STRENGTHS
    ]
    rows += [
        _row(
            f'single, strength 1, {usecase}',
            scores.of('single', strength=1.0, pose_mm=2.0, usecase=usecase),
        )
        for usecase in modes
    ]
    rows += [
        _row(f'{group}, pose error {pose:g} mm', scores.of(group, strength=strength, pose_mm=pose))
        for group, strength in (('single', 1.0), ('none', 0.0))
        for pose in poses
    ]
    rows += [
        _row(group.replace('_', ' '), scores.of(group)) for group in ('novel', 'left_out', 'pair')
    ]
    rows = [row for row in rows if row[1] != '-']
    f1 = macro_f1(f1_pairs(scores))
    return Sheet(
        f'By strength and kind (macro-F1, with novel effects as negatives: {f1:.2f})',
        (
            'cases',
            'correct',
            'named, but not first',
            'unknown',
            'wrong',
            'of which missed',
            'not detectable',
            'IoU',
            'parameter error',
        ),
        rows,
    )


def _effects(scores: Scores) -> Sheet:
    rows = []
    for name in [*sorted(CATALOGUE), *sorted(NOVEL)]:
        mine = [a for a in scores.answers if list(a.planned.effects) == [name]]
        cells = []
        for strength in STRENGTHS:
            some = [
                a
                for a in mine
                if a.planned.strength == strength and a.planned.group in ('single', 'novel')
            ]
            hits, count = share(some, lambda a: a.right)
            cells.append(f'{hits}/{count}' if count else '-')
        hits, count = share([a for a in mine if a.planned.group == 'left_out'], lambda a: a.right)
        others = [a.first for a in mine if a.planned.group != 'left_out' and not a.right]
        common = max(set(others), key=others.count) if others else ''
        if mine:
            rows.append((name, *cells, f'{hits}/{count}' if count else '-', common))
    return Sheet(
        'By effect: correct answers (novel effects: unknown or partly)',
        (
            'effect',
            *(f'{strength:g}' for strength in STRENGTHS),
            'left out',
            'most common wrong answer',
        ),
        rows,
    )


def _baselines(scores: Scores) -> Sheet:
    looked = [a for a in scores.answers if a.baselines]
    rows = []
    for name in ('this diagnosis', *(looked[0].baselines if looked else ())):
        pairs = []
        for answer in looked:
            said = answer.first if name == 'this diagnosis' else answer.baselines[name]
            pairs.append((answer, said))
        cells = []
        for group, good in (('single', None), ('none', NONE), ('novel', UNKNOWN)):
            some = [(answer, said) for answer, said in pairs if answer.planned.group == group]
            hits = sum(
                (
                    answer.right
                    if name == 'this diagnosis'
                    else said in answer.truth
                    if good is None
                    else said == good
                )
                for answer, said in some
            )
            cells.append(_percent(hits, len(some)))
        f1 = macro_f1([(next(iter(answer.planned.effects), NONE), said) for answer, said in pairs])
        rows.append((name, *cells, f'{f1:.2f}'))
    return Sheet(
        'Baselines, on the cases that they were run on',
        ('method', 'single, strength 1', 'none', 'novel', 'macro-F1'),
        rows,
    )

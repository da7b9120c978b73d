"""The results of the benchmark: tables in the terminal, a page, a picture."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import write_text
from flexx2_sim_ros.pictures import picture
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from study.benchmark.design import STRENGTHS
from study.benchmark.details import (
    first_places,
    reduction_summary,
    reductions,
    reliability,
    together,
)
from study.benchmark.goals import reach
from study.benchmark.scoring import Answer, f1_pairs, macro_f1, NONE, Scores, share, UNKNOWN
from study.benchmark.sheets import mean, most_common, percent, Sheet
from study.blind import CATALOGUE, NOVEL

_LONGEST_NAME = 32  # characters
_BY_EFFECT = 'single', 'novel', 'left_out'


def sheets(scores: Scores) -> list[Sheet]:
    """Return the tables of a run that have rows."""
    all_sheets = [
        reach(scores),
        _groups(scores),
        _places(scores),
        _effects(scores),
        together(scores),
        reduction_summary(scores),
        reductions(scores),
        first_places(scores),
        reliability(scores),
        _baselines(scores),
    ]
    return [sheet for sheet in all_sheets if sheet.rows]


def print_report(scores: Scores, console: Console) -> None:
    """Print the tables."""
    console.print(_cases(scores))
    for sheet in sheets(scores):
        table = Table(
            title=sheet.title,
            title_justify='left',
            box=box.SIMPLE_HEAD,
            collapse_padding=True,
            pad_edge=False,
        )
        # In a narrow terminal, names stay on one line and the other columns wrap.
        named = max(len(row[0]) for row in sheet.rows) <= _LONGEST_NAME
        table.add_column(sheet.columns[0], no_wrap=named)
        for name in sheet.columns[1:]:
            table.add_column(name, justify='right', overflow='fold')
        for row in sheet.rows:
            table.add_row(*row)
        console.print(table)


def write_page(scores: Scores, path: Path, command: str, picture: str) -> None:
    """
    Write the tables as Markdown.

    `picture`: file name of the confusion picture, beside the page.
    """
    facts = scores.commitment
    lines = [
        '# Benchmark of the diagnosis',
        '',
        "The diagnosis was tested on a camera whose physics is separate from the simulator's "
        '(docs/benchmark.md describes it). Brackets are 95 % Wilson intervals.',
        '',
        f'`{command}`, {facts["date"]}, {facts["seed_set"]} seeds, '
        f'version {facts["version"]}, {_cases(scores)}; {_seals(scores)}.',
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


def _seals(scores: Scores) -> str:
    *earlier, last = (f'`{one["sha256"]}`' for one in (*scores.earlier, scores.commitment))
    if not earlier:
        return f'the labels were sealed before the run (SHA-256 {last})'
    return (
        f'it was run in {len(earlier) + 1} parts, and the labels of each were sealed before it '
        f'(SHA-256 {", ".join(earlier)} and {last})'
    )


def _cases(scores: Scores) -> str:
    done, planned = len(scores.answers), scores.planned
    if done == planned:
        return f'{done} cases'
    return (
        f'the first {done} of {planned} cases (in the sealed order, which is random within each '
        'half of the design)'
    )


def draw_confusion(scores: Scores, path: Path) -> None:
    """Write a PNG of the confusion matrix over all strengths, as fractions of each row."""
    truths = [*sorted(CATALOGUE), *sorted(NOVEL), NONE]
    answers = [*sorted(CATALOGUE), UNKNOWN, NONE, 'error']
    counts = np.zeros((len(truths), len(answers)))
    for answer in scores.answers:
        if answer.planned.group in ('single', 'none', 'novel'):
            said = 'error' if answer.verdict == 'error' else answer.first
            # A name that is not in the catalogue is wrong as well.
            column = answers.index(said) if said in answers else len(answers) - 1
            counts[truths.index(next(iter(answer.planned.effects), NONE)), column] += 1
    rows = counts.sum(axis=1) > 0
    shown = counts[rows] / counts[rows].sum(axis=1, keepdims=True)
    names = [
        f'{name} ({int(n)})'
        for name, n, keep in zip(truths, counts.sum(axis=1), rows, strict=True)
        if keep
    ]
    with picture(path, figsize=(11, 0.27 * rows.sum() + 2.4)) as (figure, axes):
        _draw_matrix(axes, shown, answers, names)
        figure.colorbar(axes.images[0], label='fraction of the row', shrink=0.6)


def _draw_matrix(axes: Any, shown: np.ndarray, answers: list[str], names: list[str]) -> None:
    axes.imshow(shown, cmap='Blues', vmin=0, vmax=1, aspect='auto')
    axes.set_xticks(range(len(answers)), answers, rotation=60, ha='right')
    axes.set_yticks(range(len(shown)), names)
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


def _grouped(scores: Scores) -> list[tuple[str, list[Answer]]]:
    # Names of kinds of cases, and the answers to these; without kinds that do not occur.
    modes = sorted({a.planned.usecase for a in scores.answers})
    poses = sorted({a.planned.pose_mm for a in scores.answers})
    groups = [
        (f'single, strength {strength:g}', scores.of('single', strength=strength, pose_mm=2.0))
        for strength in STRENGTHS
    ]
    groups += [
        (f'strength 1, {usecase}', scores.of('single', strength=1.0, pose_mm=2.0, usecase=usecase))
        for usecase in modes
    ]
    groups += [
        (f'{group}, pose error {pose:g} mm', scores.of(group, strength=strength, pose_mm=pose))
        for group, strength in (('single', 1.0), ('none', 0.0))
        for pose in poses
    ]
    groups += [
        (group.replace('_', ' '), scores.of(group))
        for group in ('novel', 'left_out', 'pair', 'internals', 'one_scene', 'midway')
    ]
    groups += [
        (f'30 % of the ground truth unknown, {name}', scores.of('truth', strength=strength))
        for name, strength in (('single, strength 1', 1.0), ('none', 0.0))
    ]
    return [(name, answers) for name, answers in groups if answers]


def _groups(scores: Scores) -> Sheet:
    rows = []
    for name, answers in _grouped(scores):
        counts = (
            share(answers, counts)[0]
            for counts in (
                lambda a: a.contains and not a.right,
                lambda a: a.verdict == UNKNOWN,
                lambda a: a.wrong,
                lambda a: a.missed,
            )
        )
        rows.append((name, percent(*share(answers, lambda a: a.right)), *map(str, counts)))
    f1 = macro_f1(f1_pairs(scores))
    return Sheet(
        f'By strength and kind (macro-F1, with novel effects as negatives: {f1:.2f})',
        ('cases', 'correct', 'named later', 'unknown', 'wrong', 'of these missed'),
        rows,
    )


def _places(scores: Scores) -> Sheet:
    rows = [
        (
            name,
            f'{share(answers, lambda a: not a.visible)[0]}',
            mean([a.overlap for a in answers]),
            mean([a.parameter_error for a in answers]),
        )
        for name, answers in _grouped(scores)
        if any(a.planned.effects for a in answers)
    ]
    return Sheet(
        'Localisation and parameters, by strength and kind (not detectable: no pixel changes by '
        'more than the tolerance)',
        ('cases', 'not detectable', 'IoU', 'relative error of parameters'),
        rows,
    )


def _effects(scores: Scores) -> Sheet:
    rows = []
    for name in [*sorted(CATALOGUE), *sorted(NOVEL)]:
        mine = [
            a
            for a in scores.answers
            if list(a.planned.effects) == [name] and a.planned.group in _BY_EFFECT
        ]
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
        if mine:
            rows.append((name, *cells, f'{hits}/{count}' if count else '-', most_common(others)))
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
    for name in ('this diagnosis', *looked[0].baselines) if looked else ():
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
            cells.append(percent(hits, len(some)))
        f1 = macro_f1([(next(iter(answer.planned.effects), NONE), said) for answer, said in pairs])
        rows.append((name, *cells, f'{f1:.2f}'))
    return Sheet(
        'Baselines, on the cases that they were run on',
        ('method', 'single, strength 1', 'none', 'novel', 'macro-F1'),
        rows,
    )

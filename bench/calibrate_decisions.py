"""
Calibrate the decisions of the diagnosis: ``config/decisions.yaml``.

Draws campaigns (see `bench.decision_campaigns`), diagnoses each and writes one line of JSON for
each; an interrupted run resumes. With ``--write``, fits the rule of the verdict to all lines and
writes ``config/decisions.yaml`` and ``docs/decisions.png``. What is printed, and written as
``checked``, was measured on campaigns that the rule was not fitted to: it is fitted to four
fifths of the campaigns and checked on the last one, five times.

python -m bench.calibrate_decisions --campaigns 1000 --minutes 15 --jobs 2
python -m bench.calibrate_decisions --campaigns 1000 --write

``--quiet`` adds campaigns of full size without an effect, in a file of their own.

``--write`` also writes what was used of all lines to ``bench/decisions.jsonl.xz``. ``--kept``
reads them from there and diagnoses nothing:

python -m bench.calibrate_decisions --kept

With ``--again``, campaigns of full size and those with a measured reduction are diagnosed again,
after a change of the method. Their lines are in a second file, and replace the first.

With ``--kept --anew``, the campaigns in which only some effects were named, and whose reduction
was measured, are diagnosed again, after a change that concerns these effects alone:

python -m bench.calibrate_decisions --kept --anew heavy_tails,random_dropout --jobs 2 --write

With ``--any`` besides, it is those in which any of them was named, alone or with others. With
``--anew all`` it is all campaigns, those with large images first; ``--minutes`` limits it.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
import datetime
from multiprocessing import get_context
from pathlib import Path
import time

from bench.decision_campaigns import (
    code,
    counts_anew,
    DESIGN,
    INSIDE,
    LARGE,
    LARGE_STRENGTHS,
    MOST,
    NO_EFFECT,
    plan,
    QUIET,
    run,
    SMALL,
    STRENGTHS,
)
from bench.decision_counts import before, counted
from bench.decision_fit import calibrate, campaign, COVERED
from bench.decision_lines import keep, KEPT, kept_arguments
from bench.journal import entries, Journal
from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import whole, write_text
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.calibration.decisions import FILE, KEYS
from flexx2_sim_ros.paths import config_dir
import matplotlib as mpl
from matplotlib.figure import Figure
import numpy as np
from rich.progress import track
from study.benchmark.reliability import BINS, bins, calibration_error, least_calibration_error
from study.benchmark.scoring import wilson
import yaml

_PICTURE = config_dir().parent / 'docs' / 'decisions.png'
_MOST_ERRORS = 0.03
_FOLDS = 5
_DIGITS = 3  # of log odds
_NO_END = 1e9  # minutes
_ALL = ('all',)  # of ``--anew``
_AT_ONCE = 8  # campaigns of a process before the time is looked at
# What the table says of each list of `counted`: in words, and the wanted range.
_RATES = {
    'false_alarms': ('a gap without an effect', 0.0, _MOST_ERRORS),
    'wrong': ('effects named, and no true one among them and the alternatives', 0.0, _MOST_ERRORS),
    'covered': ('a true effect among named and alternatives', COVERED, 1.0),
    'unexplained': ('an effect that the diagnosis does not know: unknown or partly', 0.0, 1.0),
    'held': ('interval of the reduction holds', 0.85, 0.95),
    'named': ('a true effect named first', 0.0, 1.0),
}
_CURVES = {
    'strength': (
        '',
        lambda one: max(one.planned['effects'].values(), default=0.0),
        (0.1, 0.3, 0.7, 1.5, 3.1),
    ),
    'recordings': ('', lambda one: one.planned['recordings'], (2, 4, 6, 8, 13)),
    'frames': ('', lambda one: one.planned['frames'], (1, 6, 12, 25)),
    'width': ('px', lambda one: one.planned['width'], (64, 80, 112, 224, 225)),
    'pose error': ('mm', lambda one: one.planned['pose_mm'], (0, 2, 5, 11)),
}


def main():
    """Diagnose campaigns, fit the rule, print how often it is right."""
    arguments = _arguments()
    if arguments.kept:
        lines, chosen = entries(KEPT), kept_arguments()
        if arguments.anew:
            lines = _with_anew(lines, arguments)
            anew = f'--kept --anew {",".join(arguments.anew)}' + ' --any' * arguments.any
            anew += f' --minutes {arguments.minutes:g}' * (arguments.minutes < _NO_END)
            chosen = f'{chosen} --write; python -m bench.calibrate_decisions {anew}'
        report(lines, arguments.write, chosen)
        return
    options = [f'--campaigns {arguments.campaigns}']
    options += [f'--small {arguments.small}'] * (arguments.small < SMALL)
    options += [f'--quiet {arguments.quiet}'] * (arguments.quiet > 0)
    chosen = ' '.join([*options, *['--again'] * arguments.again])
    report(_lines(arguments), arguments.write, chosen)


def _arguments():
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--lines', type=Path, default=Path('build/decisions.jsonl'))
    parser.add_argument(
        '--campaigns',
        type=int,
        default=300,
        help=f'those from {SMALL} on have images of full size',
    )
    parser.add_argument('--small', type=int, default=SMALL, help='most with smaller images')
    parser.add_argument(
        '--quiet', type=int, default=0, help='campaigns of full size without an effect, besides'
    )
    parser.add_argument('--minutes', type=float, default=_NO_END, help='then stop; resumes later')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument('--again', action='store_true', help='after a change of the method')
    parser.add_argument(
        '--kept', action='store_true', help=f'the campaigns of {KEPT.name}, as diagnosed then'
    )
    parser.add_argument(
        '--anew',
        type=lambda text: tuple(text.split(',')),
        default=(),
        help='with --kept: effects; campaigns in which no other was named are diagnosed again; '
        'or all',
    )
    parser.add_argument(
        '--any', action='store_true', help='with --anew: campaigns in which others were named, too'
    )
    parser.add_argument('--write', action='store_true', help='the rule and its picture')
    arguments = parser.parse_args()
    if arguments.anew and not arguments.kept:
        parser.error('--anew: must be with --kept, got no --kept')
    for name in () if arguments.anew == _ALL else arguments.anew:
        if name not in registry():
            parser.error(f'--anew: must be names of effects, got {name}')
    for name, low, high in (
        ('campaigns', 1, QUIET),
        ('quiet', 0, MOST - QUIET),
        ('small', 1, SMALL),
    ):
        value = getattr(arguments, name)
        if not low <= value <= high:
            parser.error(f'--{name}: must be {low} to {high}, got {value}')
    return arguments


def _lines(arguments):
    # Those of the campaigns that were diagnosed until the time was over.
    design, large, no_effect = (
        {name: list(map(list, table.items())) for name, table in one.items()}
        for one in (DESIGN, LARGE, NO_EFFECT)
    )
    inside = {name: sorted(fields) for name, fields in INSIDE.items()}
    settings = {
        'design': design,
        'strengths': list(STRENGTHS),
        'inside': inside,
        'large': large,
        'large_strengths': list(LARGE_STRENGTHS),
        'small': arguments.small,
    }
    wanted = [i for i in range(arguments.campaigns) if i < arguments.small or i >= SMALL]
    journal = Journal(arguments.lines, **settings)
    ends = time.monotonic() + 60 * arguments.minutes
    _diagnose(journal, wanted[len(journal) :], arguments.jobs, ends)
    lines = list(journal)[: len(wanted)]
    if arguments.again:
        again = Journal(arguments.lines.with_suffix('.again.jsonl'), **settings)
        anew = [line['index'] for line in lines if counts_anew(line)]
        _diagnose(again, anew[len(again) :], arguments.jobs, ends)
        newer = {line['index']: line for line in again}
        lines = [newer.get(line['index'], line) for line in lines]
    if arguments.quiet:
        quiet = Journal(arguments.lines.with_suffix('.quiet.jsonl'), design=no_effect)
        some = range(QUIET, QUIET + arguments.quiet)
        _diagnose(quiet, some[len(quiet) :], arguments.jobs, ends)
        lines += list(quiet)[: arguments.quiet]
    return lines


def _with_anew(lines, arguments):
    # The lines, with those of campaigns with effects of `arguments.anew` diagnosed again.
    journal = Journal(
        arguments.lines.with_suffix('.anew.jsonl'),
        names=arguments.anew,
        any=arguments.any,
        code=code(),
    )
    ordered = sorted(lines, key=lambda line: -line['planned']['width'])
    wanted = [
        line['index']
        for line in ordered
        if arguments.anew == _ALL or _is_named(line, set(arguments.anew), arguments.any)
    ]
    ends = time.monotonic() + 60 * arguments.minutes
    # Not by number: what is named may have changed since an earlier run of the same journal.
    done = {line['index'] for line in journal}
    _diagnose(journal, [i for i in wanted if i not in done], arguments.jobs, ends)
    newer = {line['index']: line for line in journal}
    return [newer.get(line['index'], line) for line in lines]


def _is_named(line, names, or_other):
    # Whether its reduction was measured, and these effects were named: no others, or any of them.
    named = {row['name'] for row in line['diagnosis']['effects']}
    chosen = bool(named & names) if or_other else named <= names
    return (line['realised'] or {}).get('shrink') is not None and chosen


def _diagnose(journal, left, jobs, ends):
    # Adds a line for each index, until the time is over.
    with ProcessPoolExecutor(jobs, get_context('spawn')) as pool:
        for start in track(range(0, len(left), _AT_ONCE * jobs), 'diagnosing'):
            if time.monotonic() > ends:
                break
            for line in pool.map(run, left[start : start + _AT_ONCE * jobs]):
                journal.add(line)


def report(lines, write, chosen):
    """
    Fit the rule to lines of a run, print how often it is right, and write it on demand.

    * `lines`: of the run
    * `write`: whether to write the rule and its picture
    * `chosen`: the arguments that chose the campaigns
    """
    campaigns = [campaign(line) for line in lines]
    folds = [campaigns[k::_FOLDS] for k in range(_FOLDS)]
    rules = [
        calibrate([one for j, fold in enumerate(folds) if j != k for one in fold])
        for k in range(_FOLDS)
    ]
    checked = _counted(rules, folds)
    seconds = sum(line['seconds'] for line in lines)
    print(f'{len(lines)} campaigns, {seconds / 60:.0f} min of a core\n')
    _print_rates(checked, before(campaigns))
    error = calibration_error(checked['confidence'])
    chance = least_calibration_error(checked['confidence'])
    print(
        f'\nexpected calibration error of {len(checked["confidence"])} confidences: {error:.3f}; '
        f'of true probabilities, by chance: {chance:.3f}'
    )
    print(f'effects listed where there is a gap: {np.mean(checked["size"]):.1f}\n')
    _print_curves(rules, folds)
    if write:
        rule = calibrate(campaigns)
        write_text(config_dir() / FILE, _yaml(rule, lines, checked, error, chosen))
        keep(lines, chosen)
        _draw(checked['confidence'])


def _print_rates(checked, earlier):
    print('| | wanted | measured | 95 % interval | with the rule of the run |')
    print('|---|---|---|---|---|')
    for name, (words, low, high) in _RATES.items():
        hits, count = sum(checked[name]), len(checked[name])
        ends = ' to '.join(f'{100 * end:.0f}' for end in wilson(hits, count))
        wanted = f'{100 * low:.0f} to {100 * high:.0f} %' if low or high < 1 else ''
        now, then = (
            f'{100 * sum(one) / max(len(one), 1):.1f} % of {len(one)}'
            for one in (checked[name], earlier[name])
        )
        print(f'| {words} | {wanted} | {now} | {ends} % | {then} |')


def _counted(rules, folds):
    # Of each fold, by the rule that was fitted to the other folds.
    parts = [counted(rule, fold) for rule, fold in zip(rules, folds, strict=True)]
    return {name: [one for part in parts for one in part[name]] for name in parts[0]}


def _print_curves(rules, folds):
    # The same rates by how the campaigns were recorded.
    print('| | | false alarms | wrong | right first | calibration error |')
    print('|---|---|---|---|---|---|')
    for name, (unit, value, edges) in _CURVES.items():
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            some = [[one for one in fold if low <= value(one) < high] for fold in folds]
            both = _counted(rules, some)
            cells = [
                f'{sum(both[key])} of {len(both[key])}'
                for key in ('false_alarms', 'wrong', 'named')
            ]
            error = calibration_error(both['confidence'])
            print(f'| {name} | {low:g} to {high:g} {unit} | {" | ".join(cells)} | {error:.2f} |')


def _yaml(rule, lines, checked, error, chosen):
    def logistic(name, threshold):
        model = getattr(rule, name)
        return {'threshold': threshold, 'constant': model.constant, 'weights': dict(model.weights)}

    rates = {
        name: {
            'rate': round(sum(checked[name]) / max(len(checked[name]), 1), 4),
            'interval': [round(end, 4) for end in wilson(sum(checked[name]), len(checked[name]))],
            'campaigns': len(checked[name]),
        }
        for name in _RATES
    }
    table = {
        'schema': 1,
        'command': f'python -m bench.calibrate_decisions {chosen} --write',
        'date': datetime.datetime.now(datetime.UTC).strftime('%Y-%m-%d'),
        'version': __version__,
        'code': sorted({line['code'] for line in lines}),
        'campaigns': len(lines),
        'seeds': [plan(line['index'])[0].seed for line in (lines[0], lines[-1])],
        'gap': {
            **logistic('gap', rule.thresholds.probability),
            **{key: getattr(rule.thresholds, name) for name, key in KEYS.items()},
            'nulls': [round(one, _DIGITS) for one in rule.nulls],
        },
        'effect': logistic('effect', rule.least_effect),
        'alternative': logistic('rival', rule.least_alternative),
        'reduction': [
            {
                'verdict': one.verdict,
                'most': one.most,
                'least_depths': one.least_depths,
                'margin': one.margin,
            }
            for one in rule.margins
        ],
        'checked': {**rates, 'calibration_error': round(error, 4)},
    }
    head = (
        '# The rule of the verdict (docs/diagnosis_evidence.md), written by the command below;\n'
        '# `checked` was measured on campaigns that the rule was not fitted to.\n'
    )
    return head + yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=90)


def _draw(pairs):
    # The reliability diagram: how often effects with a confidence are present.
    with mpl.rc_context({'font.size': 9}):
        figure = Figure(figsize=(4.6, 4.6), layout='constrained')
        top, low = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
        top.plot([0, 1], [0, 1], color='0.6', lw=1)
        for _, _, some in bins(pairs):
            x, y = np.mean(some, axis=0)
            ends = wilson(sum(true for _, true in some), len(some))
            top.plot([x, x], ends, color='C0', lw=1.5)
            top.plot(x, y, 'o', color='C0')
        top.set(ylabel='fraction that is present', ylim=(0, 1.02), xlim=(0, 1))
        top.set_title('Named effects of campaigns left out of the fit')
        low.hist([said for said, _ in pairs], bins=BINS, range=(0, 1), color='C0')
        low.set(xlabel='confidence', ylabel='effects')
        with whole(_PICTURE) as part:
            figure.savefig(part, dpi=130, format='png')


if __name__ == '__main__':
    main()

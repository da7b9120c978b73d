"""
Calibrate the decisions of the diagnosis: ``config/decisions.yaml``.

Draws campaigns (see `bench.decision_campaigns`), diagnoses each and writes one line of JSON for
each; an interrupted run resumes. ``--campaigns`` says how many of each part: small ones, large
ones, large ones without an effect, and small ones with many effects. With ``--write``, fits the
rule of the verdict to all lines and writes ``config/decisions.yaml`` and ``docs/decisions.png``,
and what was used of all lines to ``bench/decisions.jsonl.xz``. What is printed, and written as
``checked``, was measured on campaigns that the rule was not fitted to: it is fitted to four
fifths of the campaigns and checked on the last one, five times. The last column has the same of
campaigns in other orders, lowest to highest.

python -m bench.calibrate_decisions --campaigns 600,320,120,80 --minutes 15 --jobs 2
python -m bench.calibrate_decisions --campaigns 600,320,120,80 --write

``--kept`` reads the lines of the last fit from ``bench/decisions.jsonl.xz`` and diagnoses nothing:

python -m bench.calibrate_decisions --kept
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
import datetime
import json
from multiprocessing import get_context
from pathlib import Path
import time

from bench.decision_campaigns import MOST, PARTS, run
from bench.decision_counts import counted
from bench.decision_fit import calibrate, campaign, COVERED
from bench.decision_lines import keep, KEPT, kept_arguments
from bench.journal import entries, Journal
from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import whole, write_text
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
_AGAIN = 8  # fits in other orders
_DIGITS = 3  # of log odds
_NO_END = 1e9  # minutes
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
    'effects': ('', lambda one: len(one.planned['effects']), (0, 1, 2, 3, 8, 15)),
    'recordings': ('', lambda one: one.planned['recordings'], (1, 2, 4, 6, 8, 21)),
    'frames': ('', lambda one: one.planned['frames'], (1, 6, 12, 25)),
    'width': ('px', lambda one: one.planned['width'], (64, 80, 112, 224, 225)),
    'pose error': ('mm', lambda one: one.planned['pose_mm'], (0, 2, 5, 11)),
}


def main():
    """Diagnose campaigns, fit the rule, print how often it is right."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--lines', type=Path, default=Path('build/decisions.jsonl'))
    parser.add_argument(
        '--campaigns',
        type=lambda text: tuple(map(int, text.split(','))),
        default=(600, 320, 120, 80),
        help=f'how many of each part: {", ".join(PARTS)}; at most {MOST} of each',
    )
    parser.add_argument('--minutes', type=float, default=_NO_END, help='then stop; resumes later')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument(
        '--kept', action='store_true', help=f'the campaigns of {KEPT.name}, as diagnosed then'
    )
    parser.add_argument('--write', action='store_true', help='the rule and its picture')
    arguments = parser.parse_args()
    if len(arguments.campaigns) != len(PARTS) or max(arguments.campaigns) > MOST:
        parser.error(f'--campaigns: must be {len(PARTS)} numbers up to {MOST}')
    if arguments.kept:
        report(entries(KEPT), arguments.write, kept_arguments())
    else:
        chosen = f'--campaigns {",".join(map(str, arguments.campaigns))}'
        report(_lines(arguments), arguments.write, chosen)


def _lines(arguments):
    # Those of the campaigns that were diagnosed until the time was over. Parts take turns, so that
    # a run that stops in between has some of each.
    wanted = [
        ((k + 0.5) / count, part, k)
        for part, count in zip(PARTS, arguments.campaigns, strict=True)
        for k in range(count)
    ]
    settings = json.loads(json.dumps(PARTS, default=str))
    journal = Journal(arguments.lines, parts=settings)
    wanted = [(part, k) for _, part, k in sorted(wanted)]
    done = {(line['part'], line['number']) for line in journal}
    left = [one for one in wanted if one not in done]
    ends = time.monotonic() + 60 * arguments.minutes
    with ProcessPoolExecutor(arguments.jobs, get_context('spawn')) as pool:
        step = _AT_ONCE * arguments.jobs
        for start in track(range(0, len(left), step), 'diagnosing'):
            if time.monotonic() > ends:
                break
            for line in pool.map(run, left[start : start + step]):
                journal.add(line)
    return [line for line in journal if (line['part'], line['number']) in wanted]


def report(lines, write, chosen):
    """
    Fit the rule to lines of a run, print how often it is right, and write it on demand.

    * `lines`: of the run
    * `write`: whether to write the rule and its picture
    * `chosen`: the arguments that chose the campaigns
    """
    campaigns = [campaign(line) for line in lines]
    rules, folds = _folded(campaigns)
    checked = _counted(rules, folds)
    orders = [np.random.default_rng(seed).permutation(len(lines)) for seed in range(_AGAIN)]
    again = [_counted(*_folded([campaigns[i] for i in order])) for order in orders]
    seconds = sum(line['seconds'] for line in lines)
    print(f'{len(lines)} campaigns, {seconds / 60:.0f} min of a core\n')
    _print_rates(checked, again)
    error = calibration_error(checked['confidence'])
    chance = least_calibration_error(checked['confidence'])
    print(
        f'\nexpected calibration error of {len(checked["confidence"])} confidences: {error:.3f}; '
        f'of true probabilities, by chance: {chance:.3f}; fitted again: '
        + _ends([calibration_error(one['confidence']) for one in again], '.3f')
    )
    print(f'effects listed where there is a gap: {np.mean(checked["size"]):.1f}\n')
    _print_curves(rules, folds)
    if write:
        rule = calibrate(campaigns)
        write_text(config_dir() / FILE, _yaml(rule, lines, checked, error, chosen))
        keep(lines, chosen)
        _draw(checked['confidence'])


def _print_rates(checked, again):
    # `again`: of the same campaigns in other orders, so in other folds.
    print('| | wanted | measured | 95 % interval | fitted again |')
    print('|---|---|---|---|---|')
    for name, (words, low, high) in _RATES.items():
        hits, count = sum(checked[name]), len(checked[name])
        ends = ' to '.join(f'{100 * end:.0f}' for end in wilson(hits, count))
        wanted = f'{100 * low:.0f} to {100 * high:.0f} %' if low or high < 1 else ''
        now = f'{100 * hits / max(count, 1):.1f} % of {count}'
        rates = [100 * sum(one[name]) / max(len(one[name]), 1) for one in again]
        print(f'| {words} | {wanted} | {now} | {ends} % | {_ends(rates, ".1f")} % |')


def _ends(values, form):
    return f'{min(values):{form}} to {max(values):{form}}'


def _folded(campaigns):
    # The rules that are fitted to all folds but one, and these folds.
    folds = [campaigns[k::_FOLDS] for k in range(_FOLDS)]
    rules = [
        calibrate([one for j, fold in enumerate(folds) if j != k for one in fold])
        for k in range(_FOLDS)
    ]
    return rules, folds


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
    seeds = [line['planned']['seed'] for line in lines]
    table = {
        'schema': 1,
        'command': f'python -m bench.calibrate_decisions {chosen} --write',
        'date': datetime.datetime.now(datetime.UTC).strftime('%Y-%m-%d'),
        'version': __version__,
        'code': sorted({line['code'] for line in lines}),
        'campaigns': len(lines),
        'seeds': [min(seeds), max(seeds)],
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

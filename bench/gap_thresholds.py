"""
How the answers change with the thresholds of the decisions, counted with the labels.

Judges the evidence of a benchmark's run, or of the campaigns of `bench.calibrate_decisions`, by
stricter and laxer rules than that of ``config/decisions.yaml``. Each row multiplies the excess
loss and the odds from which on there is a gap, and the odds from which on effects are named. If
no row reaches two goals at once, no common factor does. Factor 1 is the present rule.

right     one effect of strength 0.7 to 1.5, named first; half: of 0.35 to 0.7
wrong     one effect of these strengths, missed or with only others listed
alarms    a gap without an effect; 5 mm: with poses wrong by 5 mm or more
admitted  effects that the diagnosis does not know: `unknown` or `partly`

python -m bench.gap_thresholds --lines build/decisions.jsonl
python -m bench.gap_thresholds --run benchmark_output

A run is opened only after it was scored: the labels are read. No threshold is chosen from a run.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from bench.decision_fit import Campaign, campaign, first
from bench.gap_oracles import run_lines
from bench.journal import entries
from flexx2_sim_ros.gap.calibration.decisions import calibrated, Decisions, times_odds
from flexx2_sim_ros.gap.inference.probability import EXPLAINED, judge
from rich.console import Console
from rich.table import Table

FACTORS = 0.25, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 4.0
_UNEXPLAINED = 'unknown', 'partly'
_MISSING = 'novel', 'left_out'  # groups whose effect the diagnosis does not know
_FAR_MM = 5.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--lines', type=Path, default=Path('build/decisions.jsonl'))
    parser.add_argument(
        '--run', type=Path, help='--out of `flexx2 gap benchmark`, in place of lines'
    )
    arguments = parser.parse_args()
    lines = run_lines(arguments.run) if arguments.run else entries(arguments.lines)
    campaigns = [campaign(line) for line in lines]
    table = Table('factor', *(name for name, _, _ in COLUMNS), title='answers by threshold')
    for factor in FACTORS:
        table.add_row(f'{factor:g}', *counts(campaigns, scaled(calibrated(), factor)))
    Console().print(table)


def scaled(rule: Decisions, factor: float) -> Decisions:
    """Return a rule that asks for so many times the excess loss and the odds."""
    least = rule.thresholds
    scaled_least = replace(
        least,
        probability=times_odds(least.probability, factor),
        excess=least.excess * factor,
        excess_per_scatter=least.excess_per_scatter * factor,
        excess_per_fewer=least.excess_per_fewer * factor,
    )
    named = times_odds(rule.least_effect, factor)
    return replace(rule, thresholds=scaled_least, least_effect=named)


def counts(campaigns: Sequence[Campaign], rule: Decisions) -> list[str]:
    """Return how many of how many, for each of `COLUMNS`."""
    out = []
    for _, belongs, holds in COLUMNS:
        some = [one for one in campaigns if belongs(one)]
        out.append(f'{sum(holds(one, rule) for one in some)}/{len(some)}')
    return out


def _strength(one: Campaign) -> float:
    return max(one.planned['effects'].values(), default=0.0)


def _single(least: float, most: float) -> Callable[[Campaign], bool]:
    def belongs(one: Campaign) -> bool:
        return one.planned['group'] == 'single' and least <= _strength(one) < most

    return belongs


def _none(far: bool) -> Callable[[Campaign], bool]:
    def belongs(one: Campaign) -> bool:
        return one.plain and (one.planned['pose_mm'] >= _FAR_MM) == far

    return belongs


def _unknown(one: Campaign) -> bool:
    return one.planned['group'] in _MISSING


def _right(one: Campaign, rule: Decisions) -> bool:
    said = judge(one.support, rule)
    return said.verdict in EXPLAINED and first(one, said.effects) in one.true


def _wrong(one: Campaign, rule: Decisions) -> bool:
    # As the benchmark counts: missed, or no true effect named or an alternative.
    said = judge(one.support, rule)
    listed = {*said.alternatives, *(c.name for c in one.support.chosen)}
    return said.verdict == 'none' or (said.verdict in EXPLAINED and not listed & one.true)


def _alarm(one: Campaign, rule: Decisions) -> bool:
    return judge(one.support, rule).verdict != 'none'


def _admits(one: Campaign, rule: Decisions) -> bool:
    return judge(one.support, rule).verdict in _UNEXPLAINED


COLUMNS = (
    ('right', _single(0.7, 1.5), _right),
    ('right, half', _single(0.35, 0.7), _right),
    ('wrong', _single(0.35, 1.5), _wrong),
    ('alarms', _none(False), _alarm),
    ('alarms, 5 mm', _none(True), _alarm),
    ('admitted', _unknown, _admits),
)


if __name__ == '__main__':
    main()

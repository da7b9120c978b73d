"""
Measure how much the realised reduction of the same effects differs between sets of scenes.

The benchmark measures on eight other scenes which fraction of the gap goes away. A diagnosis
cannot know which scenes these will be, so it cannot predict that number better than scenes agree.
This takes the finished cases of a run whose reduction was measured, measures it once more on eight
more scenes, and prints how far the two are apart, beside the error of the prediction. If two sets
differ by d on average, a prediction that knew the mean of all scenes would be wrong by about
d / sqrt(2) on one set.

python -m bench.gap_other_scenes --run build/benchmark --jobs 2

A run is opened only after it was scored: the labels are read.
"""

import argparse
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
import json
from pathlib import Path
from typing import Any

from bench.journal import Journal
from flexx2_sim_ros import processes
from flexx2_sim_ros.gap import measure
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.benchmark.realised import FRESH, is_independent, realised_gap
from flexx2_sim_ros.validation.benchmark.sealing import open_seal
import numpy as np

_Row = Mapping[str, Any]
_GROUPS: dict[str, Callable[[_Row], bool]] = {
    'all': lambda row: True,
    'independent measure': lambda row: row['independent'],
    'strength 1, independent measure': lambda row: row['independent'] and row['full'],
}


def main() -> None:
    """Print how far predictions and two measurements of the reduction are apart."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--run', type=Path, required=True, help='--out of `flexx2 gap benchmark`')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    arguments = parser.parse_args()
    out = arguments.run
    journal = Journal(out / 'other_scenes.jsonl')
    done = {row['case'] for row in journal}
    left = [(out, name, one.to_json()) for name, one in _measured(out) if name not in done]
    with processes.workers(arguments.jobs, one_thread=True) as submit:
        for future in as_completed(submit(_again, left)):
            journal.add(future.result())
    rows = sorted(journal, key=lambda row: row['effects'])
    for row in rows:
        first, second, said = (_share(row[key]) for key in ('realised', 'again', 'predicted'))
        print(f'{row["effects"]:45s} realised {first:.2f} and {second:.2f}, predicted {said:.2f}')
    print('\n| cases | two sets of scenes differ by | prediction is wrong by |')
    print('|---|---|---|')
    for group, is_in in _GROUPS.items():
        some = [row for row in rows if row['again'] is not None and is_in(row)]
        print(f'| {group}: {len(some)} | {_apart(some, "again")} | {_apart(some, "predicted")} |')


def _measured(out: Path) -> list[tuple[str, Planned]]:
    # Finished cases with a measured reduction.
    some = []
    for name, planned in open_seal(out / 'sealed', out).cases.items():
        file = out / 'results' / f'{name}.json'
        if file.is_file():
            realised = json.loads(file.read_text())['realised']
            if realised and realised['shrink'] is not None:
                some.append((name, planned))
    return some


def _again(call: tuple[Path, str, dict[str, Any]]) -> dict[str, Any]:
    out, name, label = call
    planned = Planned.from_json(label)
    result = json.loads((out / 'results' / f'{name}.json').read_text())
    again = realised_gap(planned, result['diagnosis'], out / 'cache', measure, offset=2 * FRESH)
    return {
        'case': name,
        'effects': ' + '.join(f'{one} {value:g}' for one, value in planned.effects.items()),
        'full': planned.group == 'single' and planned.strength == 1,
        'independent': is_independent(result['realised']),
        'predicted': result['diagnosis']['gap']['shrink'],
        'realised': result['realised']['shrink'],
        'again': again['shrink'],
    }


def _share(value: float | None) -> float:
    # As the benchmark counts it: not more than all of a gap goes away.
    return np.nan if value is None else min(value, 1.0)


def _apart(rows: list[_Row], key: str) -> str:
    apart = [abs(_share(row['realised']) - _share(row[key])) for row in rows]
    return f'{np.mean(apart):.3f}, median {np.median(apart):.3f}' if apart else '-'


if __name__ == '__main__':
    main()

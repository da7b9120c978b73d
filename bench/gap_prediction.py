"""
How exactly the reduction of the gap can be predicted at all: it differs between sets of scenes.

Takes the cases of a benchmark's run in which the reduction was measured in fresh scenes. Each is
measured again in another set of fresh scenes, with the same camera and the same answer. Whoever
knew the reduction in the one set and predicted it for the other would be wrong by the difference.
The prediction of the diagnosis rests on one set of scenes, too. The mean of both sets is closer
to the reduction in all scenes than either: the prediction is compared with it as well.

python -m bench.gap_prediction --run benchmark_output

A run is opened only after it was scored: the labels are read.
"""

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
import json
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap import measure
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.benchmark.realised import FRESH, realised_gap
from flexx2_sim_ros.validation.benchmark.sealing import open_seal
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

_OTHER = FRESH + 200  # further scenes of the same range of seeds
_Call = tuple[str, dict[str, Any], dict[str, Any]]  # of a case: its name, its plan, its result


@dataclass(frozen=True)
class Measured:
    """
    A case whose reduction was measured twice.

    Attributes
    ----------
    name, verdict : str
        Of the case; of its diagnosis.
    effects : str
        The true ones.
    predicted, realised, again : float
        The reduction: as the diagnosis says, in fresh scenes, in other fresh scenes.

    """

    name: str
    verdict: str
    effects: str
    predicted: float
    realised: float
    again: float


def main() -> None:
    """Print the cases that differ most, and the mean differences by verdict."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--run', type=Path, required=True, help='--out of `flexx2 gap benchmark`')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    arguments = parser.parse_args()
    calls = _calls(arguments.run)
    with ProcessPoolExecutor(arguments.jobs, get_context('spawn')) as pool:
        found = list(track(pool.map(_again, calls), 'simulating', len(calls)))
    rows = [one for one in found if one is not None]
    _print_cases(rows)
    _print_means(rows)


def _calls(out: Path) -> list[_Call]:
    calls = []
    for name, planned in open_seal(out / 'sealed', out).cases.items():
        file = out / 'results' / f'{name}.json'
        result = json.loads(file.read_text()) if file.is_file() else {}
        if (result.get('realised') or {}).get('shrink') is not None:
            calls.append((name, planned.to_json(), result))
    return calls


def _again(call: _Call) -> Measured | None:
    name, label, result = call
    planned, table = Planned.from_json(label), result['diagnosis']
    with scratch_folder() as cache:
        shrink = realised_gap(planned, table, cache, measure, offset=_OTHER)['shrink']
    if shrink is None:
        return None
    first, said = result['realised']['shrink'], table['gap']['shrink']
    return Measured(name, table['verdict'], ' + '.join(planned.effects), said, first, shrink)


def _print_cases(rows: Sequence[Measured], most: int = 12) -> None:
    table = Table('true', 'verdict', 'predicted', 'realised', 'again', title='differ most')
    for one in sorted(rows, key=lambda row: -abs(row.again - row.realised))[:most]:
        numbers = (f'{value:.2f}' for value in (one.predicted, one.realised, one.again))
        table.add_row(one.effects, one.verdict, *numbers)
    Console().print(table)


def _print_means(rows: Sequence[Measured]) -> None:
    table = Table(
        'verdict',
        'cases',
        'predicted, realised',
        'realised, again',
        'predicted, mean of both',
        title='mean absolute differences of the reduction',
    )
    for verdict in ('identified', 'partly', ''):
        some = [one for one in rows if one.verdict == verdict or not verdict]
        if some:
            means = (f'{one:.3f}' for one in differences(some).values())
            table.add_row(verdict or 'all', str(len(some)), *means)
    Console().print(table)


def differences(rows: Sequence[Measured]) -> Mapping[str, float]:
    """Return the mean absolute differences of the table's columns."""
    said, first, again = (
        np.array([getattr(one, name) for one in rows])
        for name in ('predicted', 'realised', 'again')
    )
    return {
        'prediction': float(np.abs(said - first).mean()),
        'scenes': float(np.abs(again - first).mean()),
        'both': float(np.abs(said - (first + again) / 2).mean()),
    }


if __name__ == '__main__':
    main()

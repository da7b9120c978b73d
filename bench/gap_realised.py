"""
How much of the gap the diagnosis says that it removes, and how much it really removes.

A blind camera with one effect is diagnosed. Then it is recorded in other scenes and simulated
with the effects that were found; `validation.benchmark.realised` measures the reduction with
code of its own. Seeds are the benchmark's development seeds.

python -m bench.gap_realised --effects offset,multipath --pose 2 --seed 1
"""

import argparse
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros.gap import diagnose, measure
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.benchmark.realised import realised_gap
from flexx2_sim_ros.validation.blind import BlindCamera
from flexx2_sim_ros.validation.blind.catalogue import CATALOGUE
import numpy as np

_MODE = 'Mode_9_30fps'
_SMALL = {'width': 112, 'height': 86, 'recordings': 6, 'frames': 12}


def main() -> None:
    """Print one row for each effect, and the errors of the prediction."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--effects', default=','.join(CATALOGUE))
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--pose', type=float, default=2.0, help='error of the poses, mm')
    parser.add_argument('--seed', type=int, default=1)
    arguments = parser.parse_args()
    print(
        '| effect | verdict | named | predicted | 90 % interval | measured by | realised | '
        'fraction of the loss | worse |'
    )
    print('|---|---|---|---|---|---|---|---|---|')
    errors, held = [], []
    for name in arguments.effects.split(','):
        case = Planned(
            'single',
            _MODE,
            {name: arguments.strength},
            DEVELOPMENT.seed(1000 + arguments.seed),
            DEVELOPMENT.seed(arguments.seed),
            pose_mm=arguments.pose,
            **_SMALL,
        )
        with tempfile.TemporaryDirectory() as folder:
            BlindCamera(case.case).record(Path(folder))
            table = diagnose(folder)
            real = None
            if table['effects']:
                real = realised_gap(case, table, Path(folder), measure)['shrink']
        print(_row(name, table, real), flush=True)
        if real is not None:
            errors.append(abs(table['gap']['shrink'] - real))
            low, high = _interval(table)
            held.append(low <= real <= high)
    if errors:
        print(
            f'absolute error: mean {np.mean(errors):.2f}, median {np.median(errors):.2f}; '
            f'{sum(held)} of {len(held)} intervals hold'
        )


def _interval(table: dict[str, Any]) -> tuple[float, float]:
    # Without a gap in depth and invalid pixels, the reduction by poses has no interval: it is 0.
    low, high = table['gap']['interval'] or (0.0, 0.0)
    return low, high


def _row(name: str, table: dict[str, Any], real: float | None) -> str:
    gap = table['gap']
    named = ', '.join(row['name'] for row in table['effects'])
    low, high = _interval(table)
    cells = [
        name,
        table['verdict'],
        named,
        f'{gap["shrink"]:.2f}',
        f'{low:.2f} to {high:.2f}',
        gap['measured_by'],
        '' if real is None else f'{real:.2f}',
        f'{gap["loss"]["shrink"]:.2f}',
        ', '.join(gap['worse']),
    ]
    return f'| {" | ".join(cells)} |'


if __name__ == '__main__':
    main()

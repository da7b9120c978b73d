"""
How much of the gap the diagnosis says that it removes, and how much it really removes.

A blind camera with one effect is diagnosed. Then it is recorded in other scenes and simulated
with the effects that were found; `validation.benchmark.realised` measures the reduction with
code of its own. The same is done in the scenes of the campaign, from exactly known poses: what is
realised there differs from the prediction by the fitted poses and the measure, and the rest of
the difference is one between scenes. `--calibrate` adds a row with the calibrated effects.
`--novel` takes the effects that only the blind camera has: what is named can only imitate them.
Seeds are the benchmark's development seeds.

python -m bench.gap_realised --effects offset,multipath --pose 2 --seeds 1
python -m bench.gap_realised --novel --seeds 1,2
"""

import argparse
from pathlib import Path
import tempfile
from typing import Any

from flexx2_sim_ros.effects import load_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import calibrate, diagnose, measure
from flexx2_sim_ros.validation.benchmark import DEVELOPMENT
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.benchmark.realised import FRESH, realised_gap
from flexx2_sim_ros.validation.blind import BlindCamera
from flexx2_sim_ros.validation.blind.catalogue import CATALOGUE, NOVEL
import numpy as np

_MODE = 'Mode_9_30fps'
_SIZE = {'width': 112, 'height': 86}
_CLOSE = 0.06


def main() -> None:
    """Print a row or two for each campaign, and the errors of the prediction."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument('--effects', default=','.join(CATALOGUE))
    which.add_argument('--novel', action='store_true', help='effects outside the catalogue')
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--pose', type=float, default=2.0, help='error of the poses, mm')
    parser.add_argument('--seeds', default='1')
    parser.add_argument('--recordings', type=int, default=6)
    parser.add_argument('--frames', type=int, default=12)
    parser.add_argument('--calibrate', action='store_true')
    parser.add_argument('--cache', type=Path, help='folder for rendered scenes')
    arguments = parser.parse_args()
    print(
        '| seed | effect | verdict | named | predicted | 90 % interval | measured by | realised | '
        'in the same scenes | worse |'
    )
    print('|---|---|---|---|---|---|---|---|---|---|')
    rows: list[dict[str, Any]] = []
    names = list(NOVEL) if arguments.novel else arguments.effects.split(',')
    for seed in map(int, arguments.seeds.split(',')):
        for name in names:
            for row in _rows(arguments, seed, name):
                rows.append(row)
                print(_line(row), flush=True)
    for kind in ('diagnosed', 'calibrated'):
        some = [one for one in rows if one['kind'] == kind and one['realised'] is not None]
        if some:
            print(f'{kind}: {_summary(some)}')


def _rows(arguments: argparse.Namespace, seed: int, name: str) -> list[dict[str, Any]]:
    case = Planned(
        'single',
        _MODE,
        {name: arguments.strength},
        DEVELOPMENT.seed(1000 + seed),
        DEVELOPMENT.seed(seed),
        pose_mm=arguments.pose,
        recordings=arguments.recordings,
        frames=arguments.frames,
        **_SIZE,
    )
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        campaign, cache = folder / 'campaign', arguments.cache or folder / 'cache'
        campaign.mkdir()
        BlindCamera(case.case).record(campaign)
        table = diagnose(campaign, out=folder / 'diagnosis')
        gap = table['gap']
        row = {
            'seed': seed,
            'effect': name,
            'kind': 'diagnosed',
            'verdict': table['verdict'],
            'named': [one['name'] for one in table['effects']],
            # Without a gap in depth and invalid pixels, the reduction by poses has no interval.
            'interval': gap['interval'] or (0.0, 0.0),
            'predicted': gap['shrink'],
            'measured_by': gap['measured_by'],
            'worse': gap['worse'],
            **_realised(case, table, cache),
        }
        if not arguments.calibrate or not (
            table['alternatives'] or {*row['named']} - {'pose_error'}
        ):
            return [row]
        try:
            better = calibrate(folder / 'diagnosis', campaign, out=folder / 'calibrated')
        except InputError:
            return [row]
        effects = load_effects(folder / 'calibrated' / 'effects.yaml')
        named = [{'name': one.name, 'parameters': one.settings} for one in effects]
        gap = better['gap']
        other = {
            'kind': 'calibrated',
            'named': [one['name'] for one in named],
            'interval': gap['interval'] or (gap['shrink'],) * 2,
            'predicted': gap['shrink'],
            'measured_by': 'distance',
            'worse': sorted({unit for one in better['effects'] for unit in one['worse']}),
        }
        return [row, {**row, **other, **_realised(case, {'effects': named}, cache)}]


def _realised(case: Planned, table: dict[str, Any], cache: Path) -> dict[str, float | None]:
    if not table['effects']:
        return {'realised': None, 'same_scenes': None}
    fresh, same = (
        realised_gap(case, table, cache, measure, offset=one)['shrink'] for one in (FRESH, 0)
    )
    return {'realised': fresh, 'same_scenes': same}


def _line(row: dict[str, Any]) -> str:
    low, high = row['interval']
    name = row['effect'] if row['kind'] == 'diagnosed' else f'{row["effect"]}, calibrated'
    cells = [
        str(row['seed']),
        name,
        row['verdict'],
        ', '.join(row['named']),
        f'{row["predicted"]:.2f}',
        f'{low:.2f} to {high:.2f}',
        row['measured_by'],
        *('' if row[key] is None else f'{row[key]:.2f}' for key in ('realised', 'same_scenes')),
        ', '.join(row['worse']),
    ]
    return f'| {" | ".join(cells)} |'


def _summary(rows: list[dict[str, Any]]) -> str:
    predicted, realised = (
        np.array([row[key] for row in rows]) for key in ('predicted', 'realised')
    )
    errors = np.abs(predicted - realised)
    held = sum(row['interval'][0] <= row['realised'] <= row['interval'][1] for row in rows)
    return (
        f'absolute error mean {errors.mean():.2f}, median {np.median(errors):.2f}; '
        f'{(errors <= _CLOSE).sum()} of {len(rows)} at most {_CLOSE}; '
        f'predicted less realised {(predicted - realised).mean():+.2f}; '
        f'realised median {np.median(realised):.2f}, least {realised.min():.2f}; '
        f'{held} of {len(rows)} intervals hold'
    )


if __name__ == '__main__':
    main()

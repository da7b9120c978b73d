"""
Does `flexx2 gap cost` rank two effects by cost as the camera that has them would.

The blind camera of the benchmark has two effects, drawn at random with the seed from those that
change depth on a still scene. Its campaign is diagnosed, and the diagnosed effects are ranked by
what they take away of the difference in the consumers. The true ranking takes the camera's own
recordings in the place of simulations: with both effects, without any, and with each of the two
alone, at exact poses. An effect that the diagnosis does not name takes away nothing. `--named`
takes the two true effects at typical parameters instead of a diagnosis. Development seeds only.

python -m bench.gap_cost --seeds 1300,1301
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.consumers.loading import load, sources
from flexx2_sim_ros.consumers.running import judge, Result, Views
from flexx2_sim_ros.effects import parse_effects, registry
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.cost import compared, known_of
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.renditions import AGAIN, ALL, Known, poses_of, REAL, render, SIMULATED
from flexx2_sim_ros.gap.report.reading import read_diagnosis
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
from flexx2_sim_ros.validation.blind import BlindCamera, SceneSet
from flexx2_sim_ros.validation.blind.campaign import Case
from flexx2_sim_ros.validation.blind.catalogue import CATALOGUE
from flexx2_sim_ros.validation.blind.scene_set import SceneKey
import numpy as np

_MODE = 'Mode_9_30fps'
# Effects that change depth on a still scene; others cost these consumers nothing.
_SHOWN = {'bias', 'outliers', 'validity', 'edges'}
_EFFECTS = [
    name
    for name, kind in registry().items()
    if name in CATALOGUE
    and _SHOWN & set(kind.changes)
    and not kind.needs_motion
    and name not in ('pose_error', 'intrinsics_error', 'time_offset')
]
_LEAST_APART = 0.1  # of the two true fractions, so that there is a ranking
_NO_DISTORTION = (0.0,) * 5


def main() -> None:
    """Print a line for each campaign, and how often the rankings agree."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--seeds', default='1300')
    parser.add_argument('--width', type=int, default=112, help='of the image; 224 is the camera')
    parser.add_argument('--recordings', type=int, default=6)
    parser.add_argument('--frames', type=int, default=8)
    parser.add_argument('--consumers', default='', help='names, separated by commas')
    parser.add_argument('--named', action='store_true', help='the two true effects, typical')
    arguments = parser.parse_args()
    verdicts = []
    for seed in map(int, arguments.seeds.split(',')):
        names = sorted(np.random.default_rng(seed).choice(_EFFECTS, 2, replace=False).tolist())
        with scratch_folder() as folder:
            true, found = _rankings(arguments, DEVELOPMENT.seed(seed), names, folder)
        agree = _agree(true, found, names)
        verdicts.append(agree)
        measures = _of_measures(true, found, names)
        print(
            f'{seed} {", ".join(names)} true: {_text(true)} | cost: {_text(found)} | '
            f'{ {True: "agrees", False: "differs", None: "no true ranking"}[agree] } | '
            f'measures {sum(measures)} of {len(measures)}',
            flush=True,
        )
    counted = [one for one in verdicts if one is not None]
    print(f'{sum(counted)} of {len(counted)} rankings agree')


def _rankings(
    arguments: argparse.Namespace, seed: int, names: list[str], folder: Path
) -> tuple[dict[str, Any], dict[str, Any]]:
    height = round(arguments.width * 172 / 224)
    key = SceneKey(
        _MODE, seed, 2.0, arguments.width, height, arguments.recordings, arguments.frames
    )
    case = Case(key, dict.fromkeys(names, 1.0), seed)
    true = _true_views(case, names, folder)
    (folder / 'campaign').mkdir()
    BlindCamera(case).record(folder / 'campaign')
    known = _known(arguments.named, names, folder)
    files = [
        Found(path, flexx2().mode(_MODE), ())
        for path in sorted((folder / 'campaign').glob('*.npz'))
    ]
    rendered = [render(file, known, None, 0, None) for file in files]
    found = [one.views for one in rendered if not isinstance(one, str)]
    wanted = [one for one in arguments.consumers.split(',') if one]
    return _compared(wanted, true, names, found, list(known.effects))


def _known(named: bool, names: Sequence[str], folder: Path) -> Known:
    if named:
        effects = table_of(parse_effects(dict.fromkeys(names)))
        return Known(effects, {}, (0.01,) * 3 + (0.5,) * 3, frozenset(), {})
    diagnose(folder / 'campaign', out=folder / 'diagnosis')
    return known_of(read_diagnosis(folder / 'diagnosis'))


def _compared(
    consumers: Sequence[str],
    true: Sequence[Views],
    names: Sequence[str],
    found: Sequence[Views],
    effects: Sequence[str],
) -> tuple[dict[str, Any], dict[str, Any]]:
    # In this process: a process for each consumer takes seconds to start.
    first, second = [], []
    for source in sources(consumers, _complain):
        consumer = load(source)
        for results, views in ((first, true), (second, found)):
            errors = [judge(consumer, one)[0] for one in views]
            results.append(Result(consumer.name, '', dict(consumer.measures), errors))
    return compared(first, names), compared(second, effects)


def _complain(name: str, error: BaseException) -> None:
    print(f'{name}: {error}')


def _true_views(case: Case, names: Sequence[str], folder: Path) -> list[Views]:
    # The camera itself with both effects, without, again with other noise, and with each alone.
    case = replace(case, scenes=replace(case.scenes, pose_mm=0.0))
    scenes = SceneSet(case.scenes)
    whole = BlindCamera(case, scenes).effects
    kept = {REAL: whole, SIMULATED: (), AGAIN: (), ALL: whole}
    kept |= {name: tuple(one for one in whole if one.name == name) for name in names}
    found: dict[str, list[Any]] = {}
    for name, effects in kept.items():
        camera = BlindCamera(case, scenes)
        camera.effects = effects
        if name == AGAIN:
            camera.case = replace(case, seed=case.seed + 500_000)
        part = folder / name.replace(' ', '_')
        part.mkdir()
        camera.record(part)
        found[name] = [
            read(Found(path, scenes.optics.mode, ()), None) for path in sorted(part.glob('*.npz'))
        ]
    out = []
    for i, real in enumerate(found[REAL]):
        poses = list(poses_of(PlacedScene.at(real, np.zeros(POSE)), _NO_DISTORTION, None))
        if poses:
            seen = {
                name: tuple(p.of(some[i].depth) for p in poses) for name, some in found.items()
            }
            out.append(Views(real.name, tuple(pose.view for pose in poses), seen))
    return out


def _shares(table: dict[str, Any], names: Sequence[str]) -> list[float]:
    share = {row['effect']: row['share'] for row in table['ranking']}
    return [share.get(name, 0.0) for name in names]


def _agree(true: dict[str, Any], found: dict[str, Any], names: Sequence[str]) -> bool | None:
    real, own = (_shares(one, names) for one in (true, found))
    if abs(real[0] - real[1]) < _LEAST_APART:
        return None
    return (real[0] - real[1]) * (own[0] - own[1]) > 0


def _of_measures(true: dict[str, Any], found: dict[str, Any], names: Sequence[str]) -> list[bool]:
    # The same for each measure that differs significantly in the truth.
    own = {
        (consumer['name'], one['name']): one['effects']
        for consumer in found['consumers']
        for one in consumer['measures']
    }
    out = []
    for consumer in true['consumers']:
        for one in consumer['measures']:
            real = [one['effects'][name]['share'] for name in names]
            if not one['significant'] or abs(real[0] - real[1]) < _LEAST_APART:
                continue
            rows = own.get((consumer['name'], one['name']), {})
            mine = [rows[name]['share'] if name in rows else 0.0 for name in names]
            out.append((real[0] - real[1]) * (mine[0] - mine[1]) > 0)
    return out


def _text(table: dict[str, Any]) -> str:
    rows = [f'{row["effect"]} {row["share"]:.2f}' for row in table['ranking']]
    return ', '.join(rows) or 'no cost'


if __name__ == '__main__':
    main()

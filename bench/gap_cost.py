"""
Does `flexx2 gap cost` rank two effects by cost as the camera that has them would.

The blind camera of the benchmark has two effects, drawn at random with the seed from those that
change depth on a still scene. Its campaign is diagnosed, and the diagnosed effects are ranked by
what each changes in the consumers. The true ranking takes the camera's own recordings in the place
of simulations: with both effects, without any, and with each of the two alone, at exact poses and
with the same noise. There is none where the consumers do not differ more than by noise. A ranking
agrees if the effect that truly costs more changes more than the other, and more than nothing. An
effect that the diagnosis does not name changes nothing. A ranking orders two effects if one
changes more than the other, and more than nothing, each in 95 % of the bootstrap sets of
recordings. All others are ties; true rankings can be ties as well.

`perfect` takes a perfect simulation of the camera, whose noise differs from that of the
recordings: what it misses is a fault of the ranking alone. `by share` orders the diagnosed effects
by the fraction of the difference between recordings and simulation that each takes away.

Development seeds only. Results are kept in a file; a seed that is in it is not run again.

python -m bench.gap_cost --first 1300 --campaigns 40
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.journal import Journal
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.consumers.loading import load, sources
from flexx2_sim_ros.consumers.running import judge, Result, Views
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.cost import compared, known_of
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.renditions import AGAIN, ALL, Known, poses_of, REAL, render, SIMULATED
from flexx2_sim_ros.gap.report.reading import read_diagnosis
from flexx2_sim_ros.gap.report.words import camera_effects
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
from flexx2_sim_ros.validation.blind import BlindCamera, SceneSet
from flexx2_sim_ros.validation.blind.campaign import Case
from flexx2_sim_ros.validation.blind.catalogue import CATALOGUE
from flexx2_sim_ros.validation.blind.scene_set import SceneKey
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

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
_SETUP = 'width', 'recordings', 'frames', 'consumers'
OTHER = 'other noise'  # a rendition: with both effects, and other noise than `ALL`
TRUE, PERFECT, DIAGNOSED, BY_SHARE = 'true', 'perfect', 'diagnosed', 'by share'
_WAYS = DIAGNOSED, BY_SHARE, PERFECT
_ALL, _CERTAIN = 'all', 'the true ranking is no tie'
_BOTH, _MORE, _OTHER = 'both effects named', 'only the costlier named', 'the costlier not named'


def main() -> None:
    """Print a line for each campaign, and how often the rankings agree."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--first', type=int, default=1300, help='first development seed')
    parser.add_argument('--campaigns', type=int, default=1)
    parser.add_argument('--width', type=int, default=112, help='of the image; 224 is the camera')
    parser.add_argument('--recordings', type=int, default=8)
    parser.add_argument('--frames', type=int, default=8)
    parser.add_argument('--consumers', default='', help='names, separated by commas')
    parser.add_argument('--out', type=Path, default=Path('build/gap_cost.jsonl'))
    arguments = parser.parse_args()
    setup = {name: getattr(arguments, name) for name in _SETUP}
    journal = Journal(arguments.out, **setup)
    done = {entry['seed']: entry for entry in journal}
    seeds = range(arguments.first, arguments.first + arguments.campaigns)
    for seed in seeds:
        if seed not in done:
            done[seed] = _campaign(arguments, DEVELOPMENT.seed(seed))
            journal.add(done[seed])
        print(_line(done[seed]), flush=True)
    Console(markup=False).print(_summary([done[seed] for seed in seeds]))


def _campaign(arguments: argparse.Namespace, seed: int) -> dict[str, Any]:
    names = sorted(np.random.default_rng(seed).choice(_EFFECTS, 2, replace=False).tolist())
    height = round(arguments.width * 172 / 224)
    key = SceneKey(
        _MODE, seed, 2.0, arguments.width, height, arguments.recordings, arguments.frames
    )
    case = Case(key, dict.fromkeys(names, 1.0), seed)
    with scratch_folder() as folder:
        campaign = folder / 'campaign'
        campaign.mkdir()
        BlindCamera(case).record(campaign)
        diagnosed = diagnose(campaign, out=folder / 'diagnosis')
        named = camera_effects(diagnosed)
        wanted = [one for one in arguments.consumers.split(',') if one]
        errors = {TRUE: _errors(wanted, _true_views(case, names, folder))}
        if named:
            known = known_of(read_diagnosis(folder / 'diagnosis'))
            errors[DIAGNOSED] = _errors(wanted, _views(campaign, known))
    rows = {row['name']: row['parameters'] for row in diagnosed['effects']}
    return {
        'seed': seed,
        'effects': names,
        'named': {name: rows[name] for name in named},
        'errors': errors,
    }


def _views(campaign: Path, known: Known) -> list[Views]:
    files = [Found(path, flexx2().mode(_MODE), ()) for path in sorted(campaign.glob('*.npz'))]
    rendered = [render(file, known, None, 0, None) for file in files]
    return [one.views for one in rendered if not isinstance(one, str)]


def _errors(consumers: Sequence[str], recordings: Sequence[Views]) -> list[dict[str, Any]]:
    # In this process: a process for each consumer takes seconds to start.
    out = []
    for source in sources(consumers, _complain):
        consumer = load(source)
        errors = [judge(consumer, one)[0] for one in recordings]
        out.append({'label': consumer.name, 'measures': dict(consumer.measures), 'errors': errors})
    return out


def _complain(name: str, error: BaseException) -> None:
    print(f'{name}: {error}')


def _true_views(case: Case, names: Sequence[str], folder: Path) -> list[Views]:
    # The camera itself with both effects, without, again with other noise, and with each alone.
    case = replace(case, scenes=replace(case.scenes, pose_mm=0.0))
    scenes = SceneSet(case.scenes)
    whole = BlindCamera(case, scenes).effects
    kept = {REAL: whole, OTHER: whole, SIMULATED: (), AGAIN: (), ALL: whole}
    kept |= {name: tuple(one for one in whole if one.name == name) for name in names}
    found: dict[str, list[Any]] = {}
    for name, effects in kept.items():
        camera = BlindCamera(case, scenes)
        camera.effects = effects
        if name in (OTHER, AGAIN):
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


def _ranking(entry: dict[str, Any], way: str) -> list[dict[str, Any]]:
    # The rows of the table of `flexx2 gap cost` of the two effects, without others.
    own = way in (DIAGNOSED, BY_SHARE)
    results = []
    for one in entry['errors'].get(DIAGNOSED if own else TRUE, []):
        rows = one['errors']
        if way == PERFECT:
            rows = [{**row, REAL: row[OTHER]} for row in rows]
        results.append(Result(one['label'], '', one['measures'], rows))
    ranking = compared(results, list(entry['named'] if own else entry['effects']))['ranking']
    return [row for row in ranking if row['effect'] in entry['effects']]


def _parts(entry: dict[str, Any], way: str) -> list[float]:
    # What each effect changes of what all effects change; the one that truly costs more first.
    key = 'share' if way == BY_SHARE else 'part'
    found = {row['effect']: row[key] for row in _ranking(entry, way)}
    return [found.get(name, 0.0) for name in _by_true_cost(entry)]


def _by_true_cost(entry: dict[str, Any]) -> list[str]:
    ranked = [row['effect'] for row in _ranking(entry, TRUE)]
    return ranked or list(entry['effects'])


def _has_ranking(entry: dict[str, Any]) -> bool:
    more, less = _parts(entry, TRUE)
    return more - less >= _LEAST_APART


def _agrees(entry: dict[str, Any], way: str) -> bool:
    more, less = _parts(entry, way)
    return more > max(less, 0.0)


def _orders(entry: dict[str, Any], way: str) -> bool:
    # Whether it is no tie. An effect that is not named changes nothing.
    rows = _ranking(entry, way)
    return (
        bool(rows)
        and rows[0]['interval'][0] > 0
        and all(row['effect'] in rows[0]['ahead_of'] for row in rows[1:])
    )


def _line(entry: dict[str, Any]) -> str:
    named = ', '.join(entry['named']) or 'none'
    parts = [f'{entry["seed"]} {", ".join(_by_true_cost(entry))}; named: {named}']
    ranked = _has_ranking(entry)
    for way in (TRUE, *_WAYS):
        more, less = _parts(entry, way)
        said = (
            '' if way == TRUE or not ranked else ' agrees' if _agrees(entry, way) else ' differs'
        )
        tie = '' if way == BY_SHARE or _orders(entry, way) else ' (tie)'
        parts.append(f'{way} {more:.2f} {less:.2f}{said}{tie}')
    return '; '.join(parts)


def _summary(entries: Sequence[dict[str, Any]]) -> Table:
    # How often rankings agree, by what the diagnosis has named, and of those that are no ties.
    ranked = [one for one in entries if _has_ranking(one)]
    certain = [one for one in ranked if _orders(one, TRUE)]
    groups: dict[str, list[dict[str, Any]]] = {_ALL: ranked, _CERTAIN: certain}
    groups |= {_BOTH: [], _MORE: [], _OTHER: []}
    for one in ranked:
        more, less = (name in one['named'] for name in _by_true_cost(one))
        groups[_BOTH if more and less else _MORE if more else _OTHER].append(one)
    shown = Table(
        box=SIMPLE_HEAD, title='Rankings that agree, and of those that order the effects'
    )
    for column in ('campaigns with a true ranking', 'how many', *_WAYS):
        shown.add_column(column)
    for name, group in groups.items():
        shown.add_row(name, str(len(group)), *(_counts(group, way) for way in _WAYS))
    return shown


def _counts(group: Sequence[dict[str, Any]], way: str) -> str:
    agree = str(sum(_agrees(one, way) for one in group))
    if way == BY_SHARE:
        return agree
    ordered = [one for one in group if _orders(one, way)]
    return f'{agree}; {sum(_agrees(one, way) for one in ordered)} of {len(ordered)}'


if __name__ == '__main__':
    main()

"""
Why the diagnosis misses effects: the pose, the form of the effect, or the decision.

Takes the campaigns of `bench.calibrate_decisions`, or the finished cases of a benchmark's run,
with one effect of the blind camera that the diagnosis does not name first, and diagnoses each
again with help. ``--groups`` adds cameras with unknown internals, and pairs, of which both effects
must be named:

decision  none is needed: the true effect has the largest probability, below the threshold
pose      the same campaign with exact poses
form      the same scenes and poses, with the effects and internals that the catalogue knows
both      exact poses and the form of the catalogue

The first of these that gives the right answer is the reason. ``data``: none does, so that these
recordings hardly show the effect, at this strength.

python -m bench.gap_oracles --lines build/decisions.jsonl --strength 0.5
python -m bench.gap_oracles --run benchmark_output --strength 0.5
python -m bench.gap_oracles --run benchmark_output --groups internals,pair

A run is opened only after it was scored: the labels are read.
"""

import argparse
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from bench.decision_fit import Campaign, campaign
from bench.journal import entries
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import ageing, registry
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.calibration.decisions import calibrated
from flexx2_sim_ros.gap.inference.probability import EXPLAINED, judge
from flexx2_sim_ros.validation.benchmark.design import Planned
from flexx2_sim_ros.validation.benchmark.sealing import open_seal
from flexx2_sim_ros.validation.blind import BlindCamera, SceneSet
import numpy as np
from rich.progress import track

REASONS = 'decision', 'pose', 'form', 'both', 'data'


def main() -> None:
    """Print the reason for each effect that was missed, and how often each reason occurs."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--lines', type=Path, default=Path('build/decisions.jsonl'))
    parser.add_argument(
        '--run', type=Path, help='--out of `flexx2 gap benchmark`, in place of lines'
    )
    parser.add_argument('--strength', type=float, default=0.5, help='smallest strength')
    parser.add_argument('--groups', default='single', help='among single, internals and pair')
    arguments = parser.parse_args()
    lines = run_lines(arguments.run) if arguments.run else entries(arguments.lines)
    groups = arguments.groups.split(',')
    some = [line for line in lines if _asked(line, groups, arguments.strength)]
    missed = [line for line in some if not _named(line)]
    reasons = []
    for line in track(missed, 'diagnosing'):
        case = Planned.from_json(line['planned'])
        name, strength = ' + '.join(case.effects), min(case.effects.values())
        reasons.append(reason(line))
        print(
            f'{name:20s} {strength:5.2f} {case.recordings:2d} recordings {case.pose_mm:4.1f} mm '
            f'{reasons[-1]}',
            flush=True,
        )
    print(f'{len(missed)} of {len(some)} missed')
    for name, count in Counter(reasons).most_common():
        print(f'{name:10s} {count:3d} {100 * count / len(some):5.1f} % of all')


def run_lines(out: Path) -> list[dict[str, Any]]:
    """Return the diagnosed cases of a run of the benchmark as lines of `decision_campaigns`."""
    lines = []
    for name, planned in open_seal(out / 'sealed', out).cases.items():
        file = out / 'results' / f'{name}.json'
        diagnosis = json.loads(file.read_text())['diagnosis'] if file.is_file() else None
        if diagnosis:
            more = {'camera': 'blind', 'truth': 'exact', 'novel': ''}
            lines.append(
                {
                    'index': planned.seed,
                    'planned': planned.to_json(),
                    'more': more,
                    'diagnosis': diagnosis,
                    'realised': None,
                }
            )
    return lines


def _asked(line: Mapping[str, Any], groups: Collection[str], least: float) -> bool:
    more, planned = line['more'], line['planned']
    inside = planned['group'] == 'single' and planned.get('internals')
    return bool(
        ('internals' if inside else planned['group']) in groups
        and (more['camera'], more['truth']) == ('blind', 'exact')
        and min(planned['effects'].values()) >= least
    )


def _named(line: Mapping[str, Any]) -> bool:
    # With the present rule.
    one = campaign(line)
    said = judge(one.support, calibrated())
    return said.verdict in EXPLAINED and _right(one, _chosen(one))


def _chosen(one: Campaign) -> list[str]:
    # The effects that were selected, most probable first.
    likely = judge(one.support, calibrated()).effects
    return sorted((row.name for row in one.support.chosen), key=lambda name: -likely[name])


def _right(one: Campaign, names: Sequence[str]) -> bool:
    if one.planned['group'] == 'pair':
        return one.true <= set(names)
    return bool(names) and names[0] in one.true


def reason(line: Mapping[str, Any]) -> str:
    """Return why the effects of a line of `decision_campaigns.run` were missed."""
    one, case = campaign(line), Planned.from_json(line['planned'])
    if _right(one, _chosen(one)):
        return 'decision'
    exact = replace(case, pose_mm=0.0)
    for name, changed, own in (
        ('pose', exact, False),
        ('form', case, True),
        ('both', exact, True),
    ):
        with scratch_folder() as folder:
            (_as_in_catalogue if own else _blind)(changed, folder)
            table = diagnose(folder, seed=line['index'])
        if _right(one, [row['name'] for row in table['effects']]):
            return name
    return 'data'


def _blind(case: Planned, folder: Path) -> None:
    BlindCamera(case.case).record(folder)


def _as_in_catalogue(case: Planned, folder: Path) -> None:
    # The recordings of the blind camera, with depth of the package's camera instead.
    scenes = SceneSet(case.case.scenes)
    camera = BlindCamera(case.case, scenes)
    BlindCamera(replace(case.case, effects={}), scenes).record(folder)
    profile = flexx2().noisier(camera.sigma_factor)
    for i, path in enumerate(sorted(folder.glob('*.npz'), key=lambda one: int(one.stem))):
        with np.load(path) as archive:
            content = dict(archive)
        table: dict[str, Any] = {name: {'strength': s} for name, s in case.effects.items()}
        for name in ageing(table):
            table[name]['uptime'] = float(content['uptime'][0])
        effects = tuple(registry()[name].from_mapping(values) for name, values in table.items())
        frames = case.frames if scenes.scenes[i].path.moving else 1
        views = [scenes.true_view(i, k) for k in range(frames)]
        depth, albedo = (
            np.stack([getattr(view, name) for view in views]) for name in ('depth', 'reflectivity')
        )
        if frames == 1:
            depth, albedo = depth[0], albedo[0]
        device = Camera(case.usecase, profile=profile, effects=effects, seed=case.seed)
        seen = device.capture(depth, content['K'], content['stamp'], albedo).depth
        np.savez(path, **{**content, 'depth': seen.astype(np.float32)})


if __name__ == '__main__':
    main()

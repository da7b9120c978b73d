"""
Whether the recording that `flexx2 gap next` suggests settles what a diagnosis leaves open.

The blind camera records a few scenes, which are too few to tell its effect from others. Where the
diagnosis ends ambiguous, the first suggestion, a scene that was recorded before, and a random one
of those ranked are recorded twice each, and the campaign with either is diagnosed again. Seeds are
those of development.

python -m bench.gap_next --seeds 4
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
import shutil
import tempfile
from typing import Any
import zlib

from bench.journal import Journal
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.planning.next_recording import suggest
from flexx2_sim_ros.gap.planning.plan import default_plan, Plan, PlannedRecording, read_plan
from flexx2_sim_ros.gap.planning.scenes import Panel
from flexx2_sim_ros.gap.planning.truths import ALL_KINDS, ground_truth, Kind
from flexx2_sim_ros.validation.blind import BlindCamera, Case, SceneKey, SceneSet
from flexx2_sim_ros.validation.blind.rooms import Path as Way
from flexx2_sim_ros.validation.blind.rooms import Scene as Room
from flexx2_sim_ros.validation.blind.shapes import BOX, pack, Shape
import numpy as np
from rich.console import Console
from rich.table import Table

_USECASE = 'Mode_9_30fps'
_SIZE = 112, 86
_FRAMES = 10
_RECORDINGS = 3  # at first
_TWICE = 2  # A finding must hold on recordings that are left out of its fit.
_THICK = 0.05  # metres, half the thickness of a panel
_WAYS = 'suggestion', 'repeat', 'random'
_KIND = {kind.name: kind for kind in ALL_KINDS}
# Kinds of ground truth that are offered where a campaign has this one.
_OFFERED = {'exact': ('exact',), 'planes': ('laser',)}
# Those whose campaigns often end ambiguous.
_EFFECTS = {
    'exact': 'offset,wiggling,excess_noise,amplitude_bias,multipath,grazing_dropout',
    'planes': 'offset,wiggling,multipath,stray_light,amplitude_bias,warm_up_drift',
}


@dataclass(frozen=True)
class Start:
    """
    A campaign that may end ambiguous.

    Attributes
    ----------
    truth : str
        Kind of ground truth: ``exact`` (rooms, poses wrong by 2 mm) or ``planes`` (set-ups of the
        plan, planes fitted).
    effect : str
        Of the camera.
    strength : float
        1 is typical.
    recordings : int
        How many.
    seed : int
        Of everything.

    """

    truth: str
    effect: str
    strength: float
    recordings: int
    seed: int


class Recorder:
    """
    The blind camera of a campaign, which records more when asked.

    Parameters
    ----------
    start : Start
        The campaign.
    plan : Plan
        Set-ups that can be recorded.

    """

    def __init__(self, start: Start, plan: Plan) -> None:
        """Choose what is recorded first."""
        self.start = start
        count = start.recordings
        key = SceneKey(_USECASE, start.seed, 2.0, *_SIZE, count, _FRAMES)
        rooms = SceneSet(key)
        self._scenes = list(rooms.scenes)
        self._uptimes = list(rooms.uptimes)
        self._planned: list[PlannedRecording | None] = [None] * count
        self._kinds = [_KIND[start.truth]] * count
        if start.truth != 'exact':
            still = [one for one in plan.recordings if not one.scene.moving]
            rng = np.random.default_rng([start.seed, 21])
            chosen = [still[i] for i in rng.choice(len(still), count, replace=False)]
            self._planned = list(chosen)
            self._scenes = [as_room(one) for one in chosen]
            self._uptimes = [one.scene.uptime for one in chosen]

    def record(self, folder: Path) -> None:
        """Write the recordings that the campaign begins with."""
        self._write(folder, range(self.start.recordings))

    def again(self, folder: Path, index: int) -> None:
        """Write new recordings of a scene that was recorded before."""
        self._more(
            folder,
            self._scenes[index],
            self._uptimes[index],
            self._planned[index],
            self._kinds[index],
        )

    def add(self, folder: Path, planned: PlannedRecording, kind: Kind) -> None:
        """Write recordings of a set-up."""
        self._more(folder, as_room(planned), planned.scene.uptime, planned, kind)

    def _more(
        self, folder: Path, room: Room, uptime: float, planned: PlannedRecording | None, kind: Kind
    ) -> None:
        first = len(self._scenes)
        self._scenes += [room] * _TWICE
        self._uptimes += [uptime] * _TWICE
        self._planned += [planned] * _TWICE
        self._kinds += [kind] * _TWICE
        self._write(folder, range(first, first + _TWICE))

    def _write(self, folder: Path, only: Sequence[int]) -> None:
        start = self.start
        # Planes are measured from the camera, so a wrong pose means nothing to them.
        pose_mm = 2.0 if start.truth == 'exact' else 0.0
        key = SceneKey(_USECASE, start.seed, pose_mm, *_SIZE, len(self._scenes), _FRAMES)
        scenes = SceneSet(key)
        scenes.scenes, scenes.uptimes = tuple(self._scenes), np.array(self._uptimes)
        effects = {} if start.effect == 'none' else {start.effect: start.strength}
        BlindCamera(Case(key, effects, start.seed), scenes).record(folder, only=only)
        for i in only:
            planned, kind = self._planned[i], self._kinds[i]
            if planned is not None and kind.name != 'exact':
                self._tell(folder / f'{i}.npz', planned, kind, scenes, i)

    def _tell(
        self, file: Path, planned: PlannedRecording, kind: Kind, scenes: SceneSet, index: int
    ) -> None:
        # Replace the clean depth by what is known of it.
        with np.load(file, allow_pickle=False) as archive:
            arrays = dict(archive)
        rng = np.random.default_rng([self.start.seed, 22, index])
        lens, stamp = scenes.optics.intrinsics, arrays['stamp']
        arrays |= ground_truth(planned, lens, stamp, arrays['depth'], kind, rng)
        np.savez(file, **arrays)


def as_room(planned: PlannedRecording) -> Room:
    """Return a set-up as the blind camera's scene: panels of some thickness."""
    way = Way((0.0, 0.0, 0.0), yaw_rate=math.radians(planned.scene.turn_rate))
    return Room(planned.name, pack([_solid(panel) for panel in planned.scene.panels]), way)


def _solid(panel: Panel) -> Shape:
    across, along = np.array(panel.across), np.array(panel.along)
    normal = np.cross(across, along)
    normal *= np.sign(normal @ panel.centre) / np.linalg.norm(normal)
    centre = np.array(panel.centre) + _THICK * normal
    return Shape(
        BOX,
        (float(centre[0]), float(centre[1]), float(centre[2])),
        (float(np.linalg.norm(across)), float(np.linalg.norm(along)), _THICK),
        yaw=-math.atan2(across[2], across[0]),
        light=panel.reflectivity,
    )


def ambiguous(table: Mapping[str, Any]) -> bool:
    """
    Return whether a diagnosis leaves its cause open.

    A cause that explains the gap ``partly`` is named, as in the benchmark's score.
    """
    return bool(table['alternatives']) or table['verdict'] in ('unknown', 'not_decidable')


def judged(table: Mapping[str, Any], effect: str) -> str:
    """Return ``right``, ``wrong`` or ``open``."""
    if ambiguous(table):
        return 'open'
    named = [row['name'] for row in table['effects']] or ['none']
    return 'right' if named[0] == effect else 'wrong'


def short(table: Mapping[str, Any]) -> str:
    """Return a diagnosis in a few words."""
    words = [table['verdict'], '+'.join(row['name'] for row in table['effects'])]
    words += ['or ' + row['name'] for row in table['alternatives']]
    words += ['open ' + row['name'] for row in table['not_decidable']]
    return ' '.join(filter(None, words))


def run(start: Start, plan: Plan, jobs: int) -> dict[str, Any]:
    """Return what became of one campaign."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first, out = folder / 'campaign', folder / 'diagnosis'
        first.mkdir()
        recorder = Recorder(start, plan)
        recorder.record(first)
        table = diagnose(first, jobs=jobs, out=out)
        entry: dict[str, Any] = {'first': short(table), 'judged': judged(table, start.effect)}
        if not ambiguous(table):
            return entry
        ranked = suggest(out, plan, kinds=_OFFERED[start.truth], jobs=jobs).table['ranking']
        rng = np.random.default_rng([start.seed, zlib.crc32(start.effect.encode()), 23])
        planned = {one.name: one for one in plan.recordings}
        for way in _WAYS:
            more = folder / way
            shutil.copytree(first, more)
            row = ranked[0] if way == 'suggestion' else ranked[rng.integers(len(ranked))]
            if way == 'repeat':
                index = int(rng.integers(start.recordings))
                recorder.again(more, index)
                recorded = f'recording {index}'
            else:
                recorder.add(more, planned[row['name']], _KIND[row['truth']])
                recorded = f'{row["name"]} ({row["truth"]})'
            again = diagnose(more, jobs=jobs)
            entry[way] = {
                'recorded': recorded,
                'judged': judged(again, start.effect),
                'diagnosis': short(again),
            }
        return entry


def starts(
    seeds: Sequence[int], truths: Sequence[str], strengths: Sequence[float], effects: str
) -> list[Start]:
    """Return the campaigns, the seeds outermost."""
    out = []
    for seed in seeds:
        for truth in truths:
            names = (effects or _EFFECTS[truth]).split(',')
            for strength in strengths:
                out += [Start(truth, name, strength, _RECORDINGS, seed) for name in names]
    return out


def main() -> None:
    """Print one line a campaign, and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=4, help='how many, from 201')
    parser.add_argument('--first-seed', type=int, default=201)
    parser.add_argument('--truths', default='exact,planes')
    parser.add_argument('--strengths', default='0.5,1')
    parser.add_argument('--effects', default='')
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--journal', default='build/gap_next.jsonl', help='for going on later')
    arguments = parser.parse_args()
    plan = read_plan(default_plan())
    # The blind camera's scenes stand still.
    usable = [one for one in plan.recordings if all(one.fixed)]
    plan = replace(plan, recordings=tuple(usable))
    journal = Journal(Path(arguments.journal), size=_SIZE, frames=_FRAMES)
    done = {entry['start']: entry for entry in journal}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    strengths = [float(one) for one in arguments.strengths.split(',')]
    cases = starts(seeds, arguments.truths.split(','), strengths, arguments.effects)
    entries = []
    for number, start in enumerate(cases, 1):
        name = f'{start.truth}:{start.effect}:{start.strength:g}:{start.seed}'
        if name not in done:
            done[name] = {'start': name, **run(start, plan, arguments.jobs)}
            journal.add(done[name])
        entry = done[name]
        entries.append((start, entry))
        print(f'{number}/{len(cases)} {name}: {entry["first"]}', flush=True)
        for way in _WAYS:
            if way in entry:
                found = entry[way]
                print(
                    f'    {way:10s} {found["judged"]:5s} {found["recorded"]}: '
                    f'{found["diagnosis"]}',
                    flush=True,
                )
    Console().print(summary(entries))


def summary(entries: Sequence[tuple[Start, Mapping[str, Any]]]) -> Table:
    """Return the table: how often each way settles what is open."""
    table = Table('truth', 'recorded next', 'right', 'wrong', 'open')
    for truth in dict.fromkeys(start.truth for start, _ in entries):
        own = [entry for start, entry in entries if start.truth == truth and _WAYS[0] in entry]
        for way in _WAYS:
            counts = [
                sum(one[way]['judged'] == j for one in own) for j in ('right', 'wrong', 'open')
            ]
            table.add_row(truth, way, *(f'{count} of {len(own)}' for count in counts))
    return table


if __name__ == '__main__':
    main()

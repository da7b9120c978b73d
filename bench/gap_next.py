"""
Whether the recordings that `flexx2 gap next` suggests settle what a diagnosis leaves open.

The blind camera records a few scenes, which are too few to tell its effect from others. Where the
diagnosis ends ambiguous, the suggested set-ups are recorded twice each, and the campaign is
diagnosed again. The same is done with random sets of as many scenes of the campaign, and of as
many set-ups of the plan. The best of all these tries is what a perfect choice among
them would have reached. Seeds are those of development.

python -m bench.gap_next --seeds 4
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
import math
from pathlib import Path
import tempfile
from typing import Any
import zlib

from bench.journal import Journal
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.features.catalogue import catalogue
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.inference.decide import decidable_candidates, decide, Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.planning.next_recording import suggest
from flexx2_sim_ros.gap.planning.plan import default_plan, Plan, PlannedRecording, read_plan
from flexx2_sim_ros.gap.planning.scenes import Panel
from flexx2_sim_ros.gap.planning.truths import ALL_KINDS, ground_truth, Kind
from flexx2_sim_ros.gap.work import find, Simulations, summarise_all
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.validation.blind import BlindCamera, Case, SceneKey, SceneSet
from flexx2_sim_ros.validation.blind.rooms import Path as Way
from flexx2_sim_ros.validation.blind.rooms import Scene as Room
from flexx2_sim_ros.validation.blind.shapes import BOX, pack, Shape
import numpy as np
from rich.console import Console
from rich.table import Table

_USECASE = 'Mode_9_30fps'
_SCALE = 0.36  # of 224 x 172: of the blind camera and of the simulations
_SIZE = 80, 62
_FRAMES = 10
_RECORDINGS = 3  # at first
_TWICE = 2  # A finding must hold on recordings that are left out of its fit.
_THICK = 0.05  # metres, half the thickness of a panel
_PRIOR = (0.010,) * 3 + (0.5,) * 3  # metres, degrees: as in `diagnose`
_WAYS = 'suggestion', 'its first set-up', 'repeat', 'random'
_KIND = {kind.name: kind for kind in ALL_KINDS}
# The kind of ground truth that is offered where a campaign has this one.
_OFFERED = {'exact': 'exact', 'planes': 'laser'}
# Those whose campaigns often end ambiguous.
_EFFECTS = {
    'exact': 'offset,wiggling,excess_noise,spatial_filter,amplitude_bias,grazing_dropout',
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
        """Choose what is recorded first, and list what can be recorded next."""
        self.start = start
        first = range(start.recordings)
        offered = _KIND[_OFFERED[start.truth]]
        self.plan = [one for one in plan.recordings if offered.suits(one)]
        count = start.recordings * (1 + _TWICE) + len(self.plan) * _TWICE
        # Planes are measured from the camera, so a wrong pose means nothing to them.
        pose_mm = 2.0 if start.truth == 'exact' else 0.0
        key = SceneKey(_USECASE, start.seed, pose_mm, *_SIZE, count, _FRAMES)
        scenes = SceneSet(key)
        shots = [_Shot(scenes.scenes[i], float(scenes.uptimes[i]), None) for i in first]
        if start.truth != 'exact':
            rng = np.random.default_rng([start.seed, 21])
            chosen = rng.choice(len(self.plan), start.recordings, replace=False)
            shots = [_Shot.of(self.plan[i]) for i in chosen]
        self._kinds = [_KIND[start.truth]] * (start.recordings * (1 + _TWICE))
        shots += [shot for shot in shots for _ in range(_TWICE)]
        shots += [_Shot.of(one) for one in self.plan for _ in range(_TWICE)]
        self._kinds += [offered] * (len(shots) - len(self._kinds))
        scenes.scenes = tuple(shot.room for shot in shots)
        scenes.uptimes = np.array([shot.uptime for shot in shots])
        effects = {} if start.effect == 'none' else {start.effect: start.strength}
        self._shots, self._scenes = shots, scenes
        self._camera = BlindCamera(Case(key, effects, start.seed), scenes)

    def first(self, folder: Path) -> None:
        """Write the recordings that the campaign begins with."""
        self._write(folder, range(self.start.recordings))

    def again(self, folder: Path, index: int) -> None:
        """Write new recordings of a scene that was recorded before."""
        begin = self.start.recordings + index * _TWICE
        self._write(folder, range(begin, begin + _TWICE))

    def add(self, folder: Path, name: str) -> None:
        """Write recordings of a set-up of the plan."""
        index = [one.name for one in self.plan].index(name)
        begin = self.start.recordings * (1 + _TWICE) + index * _TWICE
        self._write(folder, range(begin, begin + _TWICE))

    def _write(self, folder: Path, only: Sequence[int]) -> None:
        self._camera.record(folder, only=only)
        for i in only:
            planned, kind = self._shots[i].planned, self._kinds[i]
            if planned is not None and kind.name != 'exact':
                self._tell(folder / f'{i}.npz', planned, kind, i)

    def _tell(self, file: Path, planned: PlannedRecording, kind: Kind, index: int) -> None:
        # Replace the clean depth by what is known of it.
        with np.load(file, allow_pickle=False) as archive:
            arrays = dict(archive)
        rng = np.random.default_rng([self.start.seed, 22, index])
        lens, stamp = self._scenes.optics.intrinsics, arrays['stamp']
        arrays |= ground_truth(planned, lens, stamp, arrays['depth'], kind, rng)
        np.savez(file, **arrays)


@dataclass(frozen=True)
class _Shot:
    # A scene of the blind camera; the set-up of the plan that it is.
    room: Room
    uptime: float
    planned: PlannedRecording | None

    @classmethod
    def of(cls, planned: PlannedRecording) -> '_Shot':
        return cls(as_room(planned), planned.scene.uptime, planned)


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


class Campaign:
    """
    The recordings of a campaign as summaries, which are diagnosed in any combination.

    Parameters
    ----------
    recorder : Recorder
        The camera.

    """

    def __init__(self, recorder: Recorder) -> None:
        """Record the first scenes."""
        self.recorder = recorder
        self.columns, self.candidates = catalogue()
        self.first = self._summaries(recorder.first)
        self._more: dict[str | int, list[Evidence]] = {}

    def with_more(self, names: Sequence[str | int]) -> Decision:
        """Diagnose with set-ups of the plan (names) and scenes recorded again (numbers)."""
        evidence = list(self.first)
        for name in names:
            if name not in self._more:
                self._more[name] = self._summaries(partial(_record, self.recorder, name))
            evidence += self._more[name]
        model = Model(evidence, self.columns, np.array(_PRIOR))
        candidates, _ = decidable_candidates(model, self.candidates, [])
        return decide(model, candidates)

    def _summaries(self, record: Callable[[Path], None]) -> list[Evidence]:
        with tempfile.TemporaryDirectory() as name, workers(1, None) as mapped:
            folder = Path(name)
            record(folder)
            found, left_out = find(folder, None, mapped)
            simulations = Simulations(None, self.columns, 0, _PRIOR)
            return summarise_all(folder, found, left_out, simulations, mapped)[1]


def _record(recorder: Recorder, name: str | int, folder: Path) -> None:
    if isinstance(name, str):
        recorder.add(folder, name)
    else:
        recorder.again(folder, name)


def judged(decision: Decision, effect: str) -> str:
    """
    Return ``right``, ``wrong`` or ``open``.

    A cause that explains the gap ``partly`` is named, as in the benchmark's score.
    """
    if not decision.settled:
        return 'open'
    named = [one.effect for one in decision.accepted.candidates] or ['none']
    return 'right' if named[0] == effect else 'wrong'


def short(decision: Decision) -> str:
    """Return a diagnosis in a few words."""
    words = [decision.verdict, '+'.join(one.effect for one in decision.accepted.candidates)]
    if decision.finds_gap:
        words += ['or ' + one.fit.candidates[-1].effect for one in decision.alternatives]
    words += ['open ' + one.effect for one in decision.undecided]
    return ' '.join(filter(None, words))


def run(start: Start, plan: Plan, tries: int, jobs: int) -> dict[str, Any]:
    """Return what became of one campaign."""
    recorder = Recorder(start, plan)
    campaign = Campaign(recorder)
    decision = campaign.with_more([])
    entry: dict[str, Any] = {'first': short(decision), 'judged': judged(decision, start.effect)}
    if entry['judged'] != 'open':
        return entry
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name) / 'campaign', Path(name) / 'diagnosis'
        folder.mkdir()
        recorder.first(folder)
        diagnose(folder, jobs=jobs, out=out)
        table = suggest(out, folder, plan, kinds=[_OFFERED[start.truth]], jobs=jobs).table
    entry['probabilities'] = table['probabilities']
    suggested = [row['name'] for row in table['suggestion']['record']]
    entry['expected'] = {key: table['suggestion'][key] for key in ('right', 'wrong')}
    rng = np.random.default_rng([start.seed, zlib.crc32(start.effect.encode()), 23])
    names, count = [one.name for one in recorder.plan], len(suggested)
    sets: dict[str, list[Sequence[str | int]]] = {
        'suggestion': [suggested],
        'its first set-up': [suggested[:1]],
        'repeat': _sets(list(range(start.recordings)), count, tries, rng),
        'random': _sets(names, count, tries, rng),
    }
    for way, several in sets.items():
        entry[way] = []
        for one in several:
            found = campaign.with_more(one)
            entry[way].append([list(one), judged(found, start.effect), short(found)])
    return entry


def _sets(
    names: Sequence[str | int], count: int, tries: int, rng: np.random.Generator
) -> list[Sequence[str | int]]:
    # As many different sets as are asked for, if there are so many.
    every = list(combinations(names, count))
    chosen = rng.choice(len(every), min(tries, len(every)), replace=False)
    return [every[i] for i in chosen]


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
    parser.add_argument(
        '--tries', type=int, default=3, help='random sets of set-ups, and of scenes again'
    )
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--journal', default='build/gap_next.jsonl', help='for going on later')
    arguments = parser.parse_args()
    plan = read_plan(default_plan())
    # The blind camera's scenes stand still.
    usable = tuple(one for one in plan.recordings if all(one.fixed))
    plan = replace(plan, recordings=usable, scale=_SCALE)
    journal = Journal(Path(arguments.journal), size=_SIZE, frames=_FRAMES, tries=arguments.tries)
    done = {entry['start']: entry for entry in journal}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    strengths = [float(one) for one in arguments.strengths.split(',')]
    cases = starts(seeds, arguments.truths.split(','), strengths, arguments.effects)
    entries = []
    for number, start in enumerate(cases, 1):
        name = f'{start.truth}:{start.effect}:{start.strength:g}:{start.seed}'
        if name not in done:
            done[name] = {'start': name, **run(start, plan, arguments.tries, arguments.jobs)}
            journal.add(done[name])
        entry = done[name]
        entries.append((start, entry))
        print(f'{number}/{len(cases)} {name}: {entry["first"]}', flush=True)
        if 'expected' in entry:
            print(f'    {entry["probabilities"]}', flush=True)
        for way in _WAYS:
            for what, judgement, words in entry.get(way, []):
                print(f'    {way:16s} {judgement:5s} {what}: {words}', flush=True)
    Console().print(summary(entries))


def summary(entries: Sequence[tuple[Start, Mapping[str, Any]]]) -> Table:
    """Return the table: how often each way settles what is open, and what was expected."""
    table = Table('truth', 'recorded next', 'right', 'wrong', 'open', 'expected right')
    for truth in dict.fromkeys(start.truth for start, _ in entries):
        own = [entry for start, entry in entries if start.truth == truth and _WAYS[0] in entry]
        for way in _WAYS:
            counts = [
                sum(np.mean([found == j for _, found, _ in one[way]]) for one in own)
                for j in ('right', 'wrong', 'open')
            ]
            cells = [f'{count:.3g} of {len(own)}' for count in counts]
            expected = sum(one['expected']['right'] for one in own)
            cells.append(f'{expected:.3g} of {len(own)}' if way == _WAYS[0] else '')
            table.add_row(truth, way, *cells)
        best = sum(
            any(found == 'right' for way in _WAYS for _, found, _ in one[way]) for one in own
        )
        table.add_row(truth, 'best of these', f'{best} of {len(own)}')
    return table


if __name__ == '__main__':
    main()

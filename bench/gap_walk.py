"""
Does the simulation predict how often a robot fails with a real camera better after the diagnosis.

The blind camera of the benchmark takes the place of the real one, with the effects that are
named. Its campaign is diagnosed. Robots walk with its images, with perfect depth, with the noise
model, and with the diagnosed effects added (`flexx2_sim_ros.gap.walk`). The figure has a curve for
each.

The prediction error is the mean difference of the failure rate from the hidden camera's, over all
terrains and step heights; its interval is that of 1000 bootstrap samples of walks. An interrupted
run resumes, and the report has all walks of the folder. Development seeds only. Multipath is
refused: it takes too long to render for thousands of images.

python -m bench.gap_walk --effects flying_pixels:2 --seed 1500 --out DIR

``--undiagnosed`` compares the hidden camera with the noise model alone: does the effect matter.
"""

import argparse
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
import json
from pathlib import Path
from typing import Any

from bench.journal import Journal
from flexx2_sim_ros.atomic import output_folder, scratch_folder, write_text
from flexx2_sim_ros.consumers.height_grid import LEAST
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.report.reading import read_diagnosis
from flexx2_sim_ros.gap.walk import cameras_of, DIAGNOSED, NOISE, PERFECT
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
from flexx2_sim_ros.validation.blind import BlindCamera, Case, SceneKey, SceneSet
from flexx2_sim_ros.validation.blind.rooms import Path as Way
from flexx2_sim_ros.validation.blind.rooms import Scene
from flexx2_sim_ros.validation.blind.shapes import BOX, pack, Shape, Solids
from flexx2_sim_ros.validation.blind.views import shared_optics
from flexx2_sim_ros.walking import ExactCamera, KINDS, Point, SimulatedCamera
from flexx2_sim_ros.walking.cameras import Views, WalkingCamera
from flexx2_sim_ros.walking.figure import draw_walks
from flexx2_sim_ros.walking.series import batches, Failures, rows, STEPS, walk_quietly
from flexx2_sim_ros.walking.terrain import Terrain
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

HIDDEN = 'hidden camera'
_MODE = 'Mode_9_30fps'
_WARM = 3600.0  # seconds since power-on
# From x ahead, y left, z up to the blind camera's world: x right, y down, z forward.
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_BEFORE, _BETWEEN = 0.5, 0.01  # seconds: of the poses before the walk, and between two of them
_SAMPLES = 1000


@dataclass(frozen=True)
class Followed(Way):
    """
    Poses at given times, and between them.

    Attributes
    ----------
    times : numpy.ndarray
        (L,) seconds.
    rotations, positions : numpy.ndarray
        (L, 3, 3) and (L, 3) metres.

    """

    times: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rotations: np.ndarray = field(default_factory=lambda: np.zeros(0))
    positions: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def moving(self) -> bool:
        """Return True."""
        return True

    def pose(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation and position; before the first and after the last time it stands."""
        at = float(np.clip(time, self.times[0], self.times[-1]))
        k = min(int(np.searchsorted(self.times, at, 'right')), len(self.times) - 1)
        near = slice(k - 1, k + 1)
        turns = Slerp(self.times[near], Rotation.from_matrix(self.rotations[near]))
        place = [np.interp(at, self.times[near], axis) for axis in self.positions[near].T]
        return turns([at]).as_matrix()[0], np.array(place)


@dataclass(frozen=True)
class HiddenCamera:
    """
    The blind camera on a walking robot.

    Attributes
    ----------
    effects : mapping of str to float
        Strength by name.
    seed : int
        Of the camera and its noise.

    """

    effects: Mapping[str, float]
    seed: int

    def __call__(self, views: Views) -> np.ndarray:
        """Take the frames of each walk."""
        cameras, looks, count, height, width = views.depth.shape
        key = SceneKey(_MODE, self.seed, 0.0, width, height, cameras * count, looks)
        scenes = SceneSet(replace(key, recordings=1))
        solids = [solids_of(views.terrain, walk) for walk in range(count)]
        scenes.key = key
        scenes.scenes = tuple(
            Scene('walk', solids[i % count], path) for i, path in enumerate(_paths(views))
        )
        scenes.times = lambda: views.times  # type: ignore[method-assign]
        scenes.twists = np.zeros((cameras * count, 6))
        scenes.uptimes = np.full(cameras * count, _WARM)
        camera = BlindCamera(Case(key, self.effects, self.seed), scenes)
        # The effects are drawn; other walks have other noise.
        noise = DEVELOPMENT.seed(self.seed + 1000 * (1 + views.first))
        camera.case = replace(camera.case, seed=noise)
        frames = [[frame.depth for frame in camera.frames(i)] for i in range(cameras * count)]
        out = np.array(frames, np.float32).reshape(cameras, count, looks, height, width)
        return np.ascontiguousarray(out.swapaxes(1, 2))


def main() -> None:
    """Print the failures of each camera and the errors of the predictions; draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--effects', required=True, help='name:strength, separated by commas')
    parser.add_argument('--seed', type=int, default=1500)
    parser.add_argument('--walks', type=int, default=200)
    parser.add_argument('--steps', default=','.join(f'{one:g}' for one in STEPS))
    parser.add_argument('--width', type=int, default=224, help='of the image')
    parser.add_argument('--recordings', type=int, default=8)
    parser.add_argument('--frames', type=int, default=16, help='of a recording')
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--undiagnosed', action='store_true')
    parser.add_argument('--out', type=Path, required=True)
    arguments = parser.parse_args()
    effects = {
        name: float(strength or 1)
        for name, _, strength in (one.partition(':') for one in arguments.effects.split(','))
    }
    if 'multipath' in effects:
        parser.error('--effects: must be without multipath')
    seed, mode = DEVELOPMENT.seed(arguments.seed), flexx2().mode(_MODE)
    size = arguments.width, round(arguments.width * 172 / 224)
    cameras: dict[str, WalkingCamera] = {
        PERFECT: ExactCamera(mode.range_max),
        NOISE: SimulatedCamera(_MODE, seed=seed),
        HIDDEN: HiddenCamera(effects, seed),
    }
    verdict = ''
    if not arguments.undiagnosed:
        key = SceneKey(_MODE, seed, 2.0, *size, arguments.recordings, arguments.frames)
        case = Case(key, effects, seed)
        verdict, cameras = _diagnosed(case, cameras, arguments.out / 'diagnosis', arguments.jobs)
    points = batches(arguments.walks, tuple(map(float, arguments.steps.split(','))))
    lens = shared_optics(_MODE, *size).intrinsics
    # Fewer pixels put fewer points into a cell.
    least = max(1, round(LEAST * (arguments.width / flexx2().intrinsics.width) ** 2))
    options = {'seed': seed, 'least': least}
    journal = Journal(
        arguments.out / 'walks.jsonl',
        effects=effects,
        width=arguments.width,
        cameras=list(cameras),
        **options,
    )
    done = [_point(entry) for entry in journal]
    left = [point for point in points if point not in done]
    with workers(arguments.jobs, None) as mapped:
        for first in range(0, len(left), arguments.jobs):
            some = left[first : first + arguments.jobs]
            work = partial(walk_quietly, cameras=cameras, lens=lens, mode=mode, **options)
            for point, failed in zip(some, mapped(work, some, lambda: None), strict=True):
                entry = {name: values.tolist() for name, values in failed.items()}
                journal.add({**asdict(point), 'failed': entry})
    _report(arguments, verdict, _gathered(journal))


def _point(entry: dict[str, Any]) -> Point:
    return Point(entry['terrain'], entry['step'], entry['first'], entry['count'])


def _gathered(journal: Journal) -> Failures:
    # All walks of the folder, by terrain and step height.
    parts = {_point(entry): entry['failed'] for entry in journal}
    found: Failures = {}
    order = list(KINDS)
    for point in sorted(parts, key=lambda one: (order.index(one.terrain), one.step, one.first)):
        own = found.setdefault((point.terrain, point.step), {})
        for name, failed in parts[point].items():
            own[name] = np.append(own.get(name, np.zeros(0, int)), failed)
    return found


def _diagnosed(
    case: Case, cameras: dict[str, WalkingCamera], folder: Path, jobs: int
) -> tuple[str, dict[str, WalkingCamera]]:
    # The verdict, and the cameras with that of the diagnosis.
    if not (folder / 'diagnosis.json').is_file():
        with scratch_folder() as campaign:
            BlindCamera(case).record(campaign)
            diagnose(campaign, out=folder, jobs=jobs)
    before = read_diagnosis(folder)
    named = ', '.join(effect.name for effect in before.effects) or 'no effect'
    try:
        _, own = cameras_of(before, None, case.seed)
    except InputError:  # Nothing is added to the noise model.
        own = {DIAGNOSED: cameras[NOISE]}
    return f'{before.verdict}: {named}', {**cameras, DIAGNOSED: own[DIAGNOSED]}


def _report(arguments: argparse.Namespace, verdict: str, found: Failures) -> None:
    table = rows(found)
    for row in table:
        low, high = row['interval']
        print(
            f'{row["terrain"]:7s} {100 * row["step"]:4.0f} cm {row["camera"]:22s} '
            f'{100 * row["share"]:5.1f} % ({100 * low:.1f} to {100 * high:.1f}) '
            f'{row["reasons"]}'
        )
    print(f'{arguments.effects}, seed {arguments.seed}, diagnosis: {verdict or "none"}')
    errors = {}
    for name in (PERFECT, NOISE, DIAGNOSED):
        if name in next(iter(found.values())):
            errors[name] = _error(found, name)
            size, low, high = errors[name]
            print(f'{name}: wrong by {size:.1f} points ({low:.1f} to {high:.1f})', flush=True)
    folder = output_folder(arguments.out)
    given = {'effects': arguments.effects, 'seed': arguments.seed, 'verdict': verdict}
    text = json.dumps({**given, 'errors': errors, 'rows': table}, indent=2)
    write_text(folder / 'walk.json', text + '\n')
    hidden = arguments.effects.replace(':', ' x ').replace(',', ', ')
    title = f'hidden camera with {hidden}; diagnosis: {verdict}'
    draw_walks(folder / 'walk.png', table, title)


def _error(found: Failures, name: str) -> tuple[float, float, float]:
    # Mean absolute difference of the failure rate from the hidden camera's, percentage points,
    # and its 90 % bootstrap interval over walks. A walk has the same terrain for all cameras.
    apart = [
        (failed[name] >= 0).astype(float) - (failed[HIDDEN] >= 0) for failed in found.values()
    ]
    rng = np.random.default_rng(0)
    samples = [
        np.mean([abs(rng.choice(one, len(one)).mean()) for one in apart]) for _ in range(_SAMPLES)
    ]
    low, high = np.quantile(samples, (0.05, 0.95))
    size = np.mean([abs(one.mean()) for one in apart])
    return 100 * float(size), 100 * float(low), 100 * float(high)


def solids_of(terrain: Terrain, walk: int) -> Solids:
    """Return the terrain of one walk in the blind camera's world."""
    shapes = []
    for block, (along, across, up) in enumerate(terrain.half):
        x, y = terrain.centre[walk, block]
        centre = _AXES @ [x, y, terrain.top[walk, block] - up]
        shapes.append(
            Shape(
                BOX,
                (float(centre[0]), float(centre[1]), float(centre[2])),
                (float(across), float(up), float(along)),
                yaw=-float(terrain.yaw[walk, block]),
                light=float(terrain.reflectivity[walk, block]),
            )
        )
    return pack(shapes)


def _paths(views: Views) -> list[Followed]:
    # Of each camera on each robot.
    times = np.arange(-_BEFORE, views.times[-1] + _BETWEEN, _BETWEEN)
    positions, rotations = views.poses(times)
    cameras, _, count = positions.shape[:3]
    return [
        Followed(
            (0.0, 0.0, 0.0),
            times=times,
            rotations=_AXES @ rotations[c, :, walk],
            positions=positions[c, :, walk] @ _AXES.T,
        )
        for c in range(cameras)
        for walk in range(count)
    ]


if __name__ == '__main__':
    main()

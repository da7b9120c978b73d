"""
How accurate ground truth from a scan is, and what it costs: ``python -m bench.truth [SEEDS]``.

A blind camera records a furnished room. Each line: an effect, the median pose error of poses
fitted alone and of poses fitted together with shared errors, and the part of the effect that the
poses took away (1: all of it is hidden in the poses, 0: nothing), from starts 5 cm and 3 degrees
off and from no pose at all. Costs come first; ``--costs`` prints nothing else, and ``--meshes``
prints time and memory of meshes of 0.2 to 5 million triangles.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
import multiprocessing
from pathlib import Path
import resource
import tempfile
import time
from typing import Any

from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.clean import render
from flexx2_sim_ros.truth.columns import Columns
from flexx2_sim_ros.truth.gray_frames import gray_images
from flexx2_sim_ros.truth.joint import Solution, solve, View
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.observation import observe
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.reflectivity import find_scale, gray_samples, with_reflectivity
from flexx2_sim_ros.truth.registration import follow, Job, register, views_of
from flexx2_sim_ros.truth.search import find
from flexx2_sim_ros.truth.shared import estimate
from flexx2_sim_ros.validation.blind.meshes import write_mesh
from flexx2_sim_ros.validation.blind.scanned import off, ScannedCamera
import numpy as np

EFFECTS: dict[str, dict[str, float]] = {
    'none': {},
    'offset 10 mm': {'offset': 1.0},
    'offset 50 mm': {'offset': 5.0},
    'wiggling 6 mm rms': {'wiggling': 1.0},
    'multipath': {'multipath': 1.0},
    'flying pixels': {'flying_pixels': 1.0},
    'wraps': {'range_wrap': 1.0},
}
# Metres: longest edges of meshes of about 0.2, 1 and 5 million triangles.
LONGEST = 0.0735, 0.033, 0.0149
_LOST = 0.3  # fraction of the pixels, for the line "30 % dropout"


@dataclass(frozen=True)
class Row:
    """A line of the table: millimetres, and fractions of the effect."""

    effect: str
    found: int
    count: int
    alone: float
    joint: float
    absorbed_alone: float
    absorbed: float
    seconds: float
    offset: str


def registered(
    folder: Path, camera: ScannedCamera, guessed: bool, rng: np.random.Generator
) -> tuple[list[View], list[Pose], float]:
    """Return views, true poses and the mean seconds of a core for each recording."""
    views, true, seconds = [], [], []
    for i in range(camera.camera.case.scenes.recordings):
        pose = camera.poses(i)[0]
        wrong = Pose(*off(pose, 0.05, 3.0, rng))
        guess = tuple(wrong.numbers()) if guessed else None
        job = Job(folder / f'{i}.npz', folder / 'room.ply', None, None, 'still', guess, '+z')
        begin = time.process_time()
        where = register(job)
        seconds.append(time.process_time() - begin)
        views += views_of((i, job, where))
        true.append(Pose(*pose))
    return views, true, float(np.mean(seconds))


def absorbed(camera: ScannedCamera, solution: Solution) -> float:
    """Return the part of the effect's depth errors that the poses explain, over all recordings."""
    own, taken = 0.0, 0.0
    for view in solution.views:
        scenes = camera.camera.scenes
        truth = scenes.clean(view.recording)[0].ravel()[view.target.pixel]
        effect = view.target.depth - truth
        hits = load_room(view.room).cast(view.pose, view.target.rays)
        shift = hits.depth - truth
        good = np.isfinite(effect + shift) & (np.abs(effect) < 0.2) & (np.abs(shift) < 0.2)
        # Means of blocks of the image: single pixels' noise is no effect.
        count = np.maximum(np.bincount(view.target.tile[good]), 1)
        means = np.bincount(view.target.tile[good], effect[good]) / count
        shifts = np.bincount(view.target.tile[good], shift[good]) / count
        own += float((count * means * means).sum())
        taken += float((count * shifts * means).sum())
    return taken / own


def measure(name: str, effects: dict[str, float], seed: int, guessed: bool) -> Row:
    """Return a line of the table for one camera."""
    camera = ScannedCamera(seed, effects)
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        camera.record(folder)
        if name.endswith('dropout'):
            _drop(folder, rng)
        write_mesh(camera.solids, folder / 'room.ply', 0.1)
        views, true, seconds = registered(folder, camera, guessed, rng)
        alone = solve(views, Columns(False, (), False))
        good = [i for i, view in enumerate(alone.views) if _error(view.pose, true[i]) < 0.1]
        if not good:
            return Row(name, 0, len(true), *[np.nan] * 4, seconds, '')
        shared = estimate([alone.views[i] for i in good])
        after = shared.solution
        finding: dict[str, Any] = shared.findings['offset']
        return Row(
            name,
            len(good),
            len(true),
            float(np.median([_error(alone.views[i].pose, true[i]) for i in good])) * 1e3,
            float(np.median([_error(v.pose, true[v.recording]) for v in after.views])) * 1e3,
            absorbed(camera, alone),
            absorbed(camera, after),
            seconds,
            f'{finding["verdict"]} {finding["metres"] * 1e3:+.1f}',
        )


def _error(pose: Pose, true: Pose) -> float:
    return float(np.linalg.norm(true.motion_to(pose)[:3]))


def _drop(folder: Path, rng: np.random.Generator) -> None:
    for file in folder.glob('*.npz'):
        with np.load(file, allow_pickle=False) as archive:
            arrays = dict(archive)
        lost = rng.random(arrays['depth'].shape[1:]) < _LOST
        arrays['depth'][:, lost] = np.nan
        np.savez(file, **arrays)


def costs() -> None:
    """Print what each part costs one core, for 224 x 172 pixels and 200,000 triangles."""
    camera = ScannedCamera(1, {})
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        camera.record(folder)
        path = folder / 'room.ply'
        write_mesh(camera.solids, path, LONGEST[0])
        print(f'{load_room(path).triangles:,} triangles')
        _still(folder, camera, path)


def meshes() -> None:
    """Print time and memory of loading meshes, each in a process of its own."""
    print('| triangles | s | us a triangle | GB | kB a triangle |')
    print('|---|---|---|---|---|')
    spawn = multiprocessing.get_context('spawn')
    solids = ScannedCamera(1, {}, recordings=1, frames=1).solids
    with tempfile.TemporaryDirectory() as text:
        for longest in LONGEST:
            path = Path(text) / 'room.ply'
            write_mesh(solids, path, longest)
            with spawn.Pool(1) as pool:
                count, seconds, taken = pool.apply(_load, (path,))
            print(
                f'| {count:,} | {seconds:.1f} | {seconds / count * 1e6:.1f} | {taken / 1e9:.2f} | '
                f'{taken / count / 1e3:.2f} |',
                flush=True,
            )


def _load(path: Path) -> tuple[int, float, int]:
    # Triangles, seconds of a core, and bytes at the peak beyond what the imports take.
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    room, seconds = _timed(load_room, path)
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return room.triangles, seconds, taken * 1024


def _still(folder: Path, camera: ScannedCamera, path: Path) -> None:
    room = load_room(path)
    guess = Pose(*off(camera.poses(0)[0], 0.05, 3.0, np.random.default_rng(0)))
    for _ in range(2):  # The first compiles.
        footage, looked = _timed(observe, open_recording(folder / '0.npz'), None)
        found, searched = _timed(find, room, footage.still, guess, None, '+z')
        _, rendered = _timed(render, room, found.fit.pose, footage.still.rays, 0.003)
    print(f'still recording: read {looked:.2f}, registered {searched:.2f}, ', end='')
    print(f'rendered {rendered:.3f} s, ', end='')
    clean = render(room, found.fit.pose, footage.still.rays, 0.003)
    rays, gray = footage.still.rays, next(gray_images(footage.reader, False))
    sample = gray_samples(gray, clean, rays)
    scale = find_scale([] if sample is None else [sample])
    assert scale is not None
    _, lit = _timed(with_reflectivity, clean, gray, rays, scale)
    print(f'reflectivity {lit:.3f} s')
    image = next(iter(footage.reader.frames('depth')))
    times = []
    for _ in range(10):
        frame, first = _timed(footage.observe, image)
        _, second = _timed(follow, room, frame, found.fit.pose)
        _, third = _timed(render, room, found.fit.pose, frame.rays, 0.003)
        times.append(first + second + third)
    print(f'moving recording: {np.median(times) * 1e3:.0f} ms a frame')


def _timed(work: Callable[..., Any], *given: Any) -> tuple[Any, float]:
    begin = time.process_time()
    out = work(*given)
    return out, time.process_time() - begin


def main(seeds: int) -> None:
    """Print the table."""
    print('effect, start: found | mm alone, joint | absorbed alone, joint | s | offset mm')
    for guessed in (True, False):
        for name, effects in {**EFFECTS, '30 % dropout': {}}.items():
            for seed in range(1, seeds + 1):
                row = measure(name, effects, seed, guessed)
                print(
                    f'{name}, {"5 cm, 3 deg" if guessed else "none"}: {row.found}/{row.count} | '
                    f'{row.alone:.2f}, {row.joint:.2f} | {row.absorbed_alone:.2f}, '
                    f'{row.absorbed:.2f} | {row.seconds:.2f} | {row.offset}',
                    flush=True,
                )


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description='Measure ground truth from a scan.')
    parser.add_argument('seeds', nargs='?', type=int, default=2, help='rooms')
    parser.add_argument('--costs', action='store_true', help='print costs only')
    parser.add_argument('--meshes', action='store_true', help='print costs of large meshes only')
    given = parser.parse_args()
    if given.meshes:
        meshes()
    else:
        costs()
        if not given.costs:
            main(given.seeds)

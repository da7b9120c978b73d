"""
What ground truth from a scan costs the diagnosis: ``python -m bench.gap_end_to_end --out DIR``.

A blind camera records one furnished room from several places, with one effect of strength 1 or
none. Its recordings become bags as a real camera's: depth, gray image, camera info and mode,
without the truth. `flexx2 gap truth` makes the ground truth from the room's mesh. It is told poses
that are wrong by 5 cm and 3 degrees, or none. A late camera (`time_offset`) walks and turns to and
fro, and the poses are a trajectory with its clock; give it ``--frames 40``. `flexx2 gap diagnose`
then diagnoses each of the two campaigns, and the same recordings with the true clean depth. An
interrupted run resumes.

``--over-topics N`` sends the recordings of the first N cameras over real topics (`bench.stand_in`
and `flexx2 record`) and checks that the bags have the same frames as those that were written.
"""

import argparse
from collections.abc import Sequence
import contextlib
from dataclasses import replace
import io
import json
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any

from bench.journal import Journal
from bench.stand_in import DRIVER
from flexx2_sim_ros.cli.main import main as flexx2
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.validation.blind import CATALOGUE
from flexx2_sim_ros.validation.blind.meshes import mesh_pose, write_mesh
from flexx2_sim_ros.validation.blind.rooms import Path as Walk
from flexx2_sim_ros.validation.blind.scanned import off, ScannedCamera
import numpy as np
import yaml

TRUTHS = 'exact', 'told', 'found'
# The poses are fitted to the recordings, so a scan cannot show these.
OPEN = 'pose_error', 'time_offset'
_METRES, _DEGREES = 0.05, 3.0
_POWER_ON = 1.7e9  # seconds, the stamp at which the camera was switched on
_LATE = 'time_offset'
_MOVING = 'motion_artefact', _LATE
_KEPT = 'depth', 'K', 'stamp', 'usecase'


class Swaying(Walk):
    """A walk on which the camera turns to and fro without a period."""

    def pose(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose at a time in seconds."""
        turn = 0.1 * np.sin(7 * time) + 0.06 * np.sin(17 * time + 1) + 0.05 * np.sin(11.3 * time)
        pose = Pose(*super().pose(time)).moved(np.array([0, 0, 0, 0.3 * turn, turn, 0]))
        return pose.R, pose.t


def sway(camera: ScannedCamera) -> None:
    """Let the camera sway on its walks."""
    scenes = camera.camera.scenes
    scenes.scenes = tuple(
        replace(scene, path=Swaying(**vars(scene.path))) for scene in scenes.scenes
    )


def make(folder: Path, name: str, seed: int, recordings: int, frames: int) -> ScannedCamera:
    """Write ``exact/`` with the truth, ``bags/`` without it, and the room as a mesh."""
    effects = {} if name == 'none' else {name: 1.0}
    camera = ScannedCamera(
        seed, effects, recordings, frames, width=112, height=86, moving=name in _MOVING
    )
    if name == _LATE:
        sway(camera)
    (folder / 'exact').mkdir()
    (folder / 'bags').mkdir()
    # One clock: the stamps say how long after one another the recordings were made.
    camera.camera.stamps = _POWER_ON + camera.camera.scenes.uptimes
    camera.record(folder / 'exact', told=True)
    for path in sorted((folder / 'exact').glob('*.npz')):
        with np.load(path, allow_pickle=False) as archive:
            arrays = dict(archive)
        # The driver's gray images have eight bits.
        gray = np.clip(np.rint(arrays.pop('amplitude')), 0, 255).astype(np.uint8)
        gray = np.broadcast_to(gray, arrays['depth'].shape)
        np.savez(path, **arrays, amplitude=gray)
        told = folder / 'untold.npz'
        np.savez(told, **{key: arrays[key] for key in _KEPT}, amplitude=gray)
        run('convert', told, folder / 'bags' / path.stem, '--camera', DRIVER)
    write_mesh(camera.solids, folder / 'room.ply', 0.1)
    return camera


def run(*words: object) -> None:
    """Run a command of the package in this process; all has to be well."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        status = flexx2([str(word) for word in words])
    if status:
        raise RuntimeError(f'flexx2 {words[0]}: {said.getvalue()[-500:]}')


def over_topics(folder: Path) -> None:
    """Record each bag anew from a stand-in's topics, compare, and put it in the bag's place."""
    for bag in sorted((folder / 'bags').iterdir()):
        new = folder / f'new_{bag.name}'
        record(folder / 'exact' / f'{bag.name}.npz', new)
        written, recorded = load_recording(bag), load_recording(new)
        assert np.array_equal(written.depth, recorded.depth, equal_nan=True), bag
        assert recorded.usecase == written.usecase, bag
        for key in ('amplitude', 'K', 'stamp_ns'):
            assert np.array_equal(getattr(written, key), getattr(recorded, key)), (bag, key)
        shutil.rmtree(bag)
        new.rename(bag)


def record(source: Path, bag: Path) -> None:
    """Record a bag while a stand-in of the driver publishes a recording."""
    program = [sys.executable, '-m']
    with subprocess.Popen([*program, 'bench.stand_in', str(source)]) as driver:
        words = ['record', str(bag), '--seconds', '2']
        try:
            subprocess.run(
                [*program, 'flexx2_sim_ros.cli.main', *words], check=True, capture_output=True
            )
        finally:
            driver.terminate()  # It would wait for a subscriber for ever.


def guesses(camera: ScannedCamera, seed: int) -> list[str]:
    """Return options that tell each recording's pose wrongly."""
    rng = np.random.default_rng(seed)
    words = []
    for i in range(camera.camera.case.scenes.recordings):
        pose = Pose(*off(camera.poses(i)[0], _METRES, _DEGREES, rng))
        words.append('--pose=' + ','.join(f'{number:.6f}' for number in pose.numbers()))
    return words


def trajectory(path: Path, camera: ScannedCamera, seed: int, behind: float = 0.0) -> list[str]:
    """
    Write a trajectory with poses that are all wrong in the same way, at 100 Hz.

    Parameters
    ----------
    path : pathlib.Path
        The file to write, TUM.
    camera : ScannedCamera
        What to record.
    seed : int
        Of the error.
    behind : float
        How far its clock is behind that of the recordings, seconds.

    Returns
    -------
    list of str
        Options of `flexx2 gap truth`.

    """
    lines, scenes = [], camera.camera.scenes
    for scene, start in zip(scenes.scenes, camera.camera.stamps, strict=True):
        for moment in np.arange(-0.5, scenes.times()[-1] + 0.5, 0.01):
            pose = mesh_pose(scene.path.pose(float(moment)))
            wrong = Pose(*off(pose, _METRES, _DEGREES, np.random.default_rng(seed)))
            numbers = ' '.join(f'{number:.6f}' for number in wrong.numbers())
            lines.append(f'{start + moment - behind:.6f} {numbers}')
    path.write_text('\n'.join(lines))
    return ['--trajectory', str(path)]


def diagnosed(folder: Path, truth: str, told: Sequence[str], room_error: float) -> dict[str, Any]:
    """Return what the diagnosis says with one kind of ground truth."""
    begin = time.perf_counter()
    campaign, verdicts = folder / truth, []
    if truth != 'exact':
        words = ['--scan', folder / 'room.ply', '--out', campaign, '--room-error', room_error]
        run('gap', 'truth', folder / 'bags', *words, '--jobs', 1, *told)
        rows = yaml.safe_load((campaign / 'truth.yaml').read_text())['recordings']
        verdicts = [row['verdict'] for row in rows]
    out = folder / f'diagnosis_{truth}'
    run('gap', 'diagnose', campaign, '--out', out, '--jobs', 1)
    said = json.loads((out / 'diagnosis.json').read_text())
    return {
        'truth': truth,
        'verdict': said['verdict'],
        'effects': [row['name'] for row in said['effects']],
        'alternatives': [row['name'] for row in said['alternatives']],
        'not_decidable': [row['name'] for row in said['not_decidable']],
        'recordings': verdicts,
        'seconds': round(time.perf_counter() - begin, 1),
    }


def first(row: dict[str, Any]) -> str:
    """Return the first effect that is named, or the verdict where none is."""
    named = row['verdict'] in ('identified', 'partly') and row['effects']
    return str(row['effects'][0] if named else row['verdict'])


def right(row: dict[str, Any]) -> bool:
    """Whether a diagnosis names the effect first, or nothing where there is none."""
    if row['effect'] == 'none':
        return row['verdict'] in ('none', 'not_decidable')
    return first(row) == row['effect']


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the results as Markdown."""
    cases: dict[tuple[int, str], dict[str, dict[str, Any]]] = {}
    for row in rows:
        cases.setdefault((row['seed'], row['effect']), {})[row['truth']] = row
    lines = [
        '| seed | effect | true depth | told wrong poses | told none |',
        '|---|---|---|---|---|',
    ]
    for (seed, effect), case in sorted(cases.items()):
        cells = [_cell(case.get(truth)) for truth in TRUTHS]
        lines.append(f'| {seed} | {effect} | {" | ".join(cells)} |')
    for truth in TRUTHS[1:]:
        both = [case for case in cases.values() if 'exact' in case and truth in case]
        some = [
            case[truth]
            for case in both
            if right(case['exact']) and case[truth]['effect'] not in ('none', *OPEN)
        ]
        none = [case for case in both if case[truth]['effect'] == 'none']
        alarms, before = (sum(not right(case[kind]) for case in none) for kind in (truth, 'exact'))
        lines.append(
            f'\n{truth}: {sum(map(right, some))} of {len(some)} that are right with true depth; '
            f'{alarms} false alarms in {len(none)} ({before} with true depth)'
        )
    return '\n'.join(lines)


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ''
    return first(row) + (' (open)' if row['effect'] in row['not_decidable'] else '')


def main() -> None:
    """Run what is left, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, required=True)
    parser.add_argument('--effects', default='none,all', help='names; all: the whole catalogue')
    parser.add_argument('--truths', default=','.join(TRUTHS), help='kinds of ground truth')
    parser.add_argument('--seeds', default='101')
    parser.add_argument('--recordings', type=int, default=6)
    parser.add_argument('--frames', type=int, default=10)
    parser.add_argument('--room-error', type=float, default=0.0005, help='metres, of the mesh')
    parser.add_argument('--over-topics', type=int, default=1, metavar='N')
    arguments = parser.parse_args()
    names: list[str] = []
    for name in arguments.effects.split(','):
        names += sorted(CATALOGUE) if name == 'all' else [name]
    journal = Journal(
        arguments.out / 'results.jsonl',
        recordings=arguments.recordings,
        frames=arguments.frames,
        room_error=arguments.room_error,
    )
    for seed in map(int, arguments.seeds.split(',')):
        for name in dict.fromkeys(names):
            _case(journal, arguments, name, seed)
    print(table(list(journal)))


def _case(journal: Journal, arguments: argparse.Namespace, name: str, seed: int) -> None:
    done = {(row['effect'], row['seed'], row['truth']) for row in journal}
    left = [t for t in arguments.truths.split(',') if (name, seed, t) not in done]
    if not left:
        return
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        camera = make(folder, name, seed, arguments.recordings, arguments.frames)
        topics = len({(effect, at) for effect, at, _ in done}) < arguments.over_topics
        if topics:
            over_topics(folder)
        for truth in left:
            told = []
            if truth == 'told' and name == _LATE:
                told = [*trajectory(folder / 'mocap.txt', camera, seed), '--clock-offset', '0']
            elif truth == 'told':
                told = guesses(camera, seed)
            row = diagnosed(folder, truth, told, arguments.room_error)
            row |= {'effect': name, 'seed': seed, 'over_topics': topics}
            journal.add(row)
            print(name, seed, truth, first(row), flush=True)


if __name__ == '__main__':
    main()

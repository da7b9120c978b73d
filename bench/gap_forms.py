"""
How much of the gap goes away on fresh scenes: effects as diagnosed, and calibrated.

The blind camera of the benchmark records a campaign with one effect. The campaign is diagnosed,
then the diagnosis is calibrated on the same recordings. Both files of effects are simulated on
other scenes that the same camera has recorded at exactly known poses. Printed is what goes away
of the distance between recording and simulation: 1 - (with - floor) / (without - floor). With
it, what the calibration predicts from left-out recordings, by the distance of docs/diagnosis.md.
The distance is computed here: mean Wasserstein-1 distance of depth errors in sigma over tiles of
4 x 4 pixels, plus the mean absolute difference of the fraction of invalid pixels. The floor is
the distance of two simulations. Development seeds only.

python -m bench.gap_forms --effects offset,wiggling --seeds 900
"""

import argparse
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import ageing, Effect, load_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import calibrate, diagnose
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
from flexx2_sim_ros.validation.blind import BlindCamera, SceneSet
from flexx2_sim_ros.validation.blind.campaign import Case
from flexx2_sim_ros.validation.blind.internals import Internals
from flexx2_sim_ros.validation.blind.scene_set import SceneKey
import numpy as np
import yaml

EFFECTS = (
    'offset,warm_up_drift,wiggling,amplitude_bias,fixed_pattern,grazing_dropout,'
    'low_signal_dropout,saturation,flying_pixels,multipath,stray_light,range_wrap,'
    'temporal_filter,spatial_filter'
)
_FRESH = 500  # added to the seed of the scenes
_TILE = 4


def main() -> None:
    """Print one line for each campaign."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--effects', default=EFFECTS)
    parser.add_argument('--seeds', default='900')
    parser.add_argument('--strength', type=float, default=1.0)
    parser.add_argument('--pose-mm', type=float, default=2.0)
    parser.add_argument('--width', type=int, default=112, help='of the image; 224 is the camera')
    parser.add_argument(
        '--mhz', type=float, help="the camera's one modulation frequency, unlike its profile"
    )
    parser.add_argument(
        '--internals', default='{}', help='of the camera, such as {memory: mean, memory_frames: 5}'
    )
    parser.add_argument('--usecase', default='Mode_9_30fps')
    parser.add_argument('--cache', type=Path, help='folder for rendered scenes')
    parser.add_argument('--jobs', type=int, default=2)
    arguments = parser.parse_args()
    print(
        'seed effect                 named                          diagnosed calibrated  '
        'predicted  form'
    )
    for seed in map(int, arguments.seeds.split(',')):
        for name in arguments.effects.split(','):
            with scratch_folder() as folder:
                print(_line(arguments, DEVELOPMENT.seed(seed), name, folder), flush=True)


def _line(arguments: argparse.Namespace, seed: int, name: str, folder: Path) -> str:
    height = round(arguments.width * 172 / 224)
    key = SceneKey(arguments.usecase, seed, arguments.pose_mm, arguments.width, height, 8, 20)
    internals = Internals(**yaml.safe_load(arguments.internals))
    case = Case(key, {name: arguments.strength}, seed, internals=internals)
    campaign, fresh, diagnosis, calibrated = (
        folder / part for part in ('campaign', 'fresh', 'diagnosis', 'calibrated')
    )
    campaign.mkdir()
    fresh.mkdir()
    BlindCamera(case, _scenes(key, arguments)).record(campaign)
    other = replace(key, seed=seed + _FRESH, pose_mm=0.0, recordings=5, frames=8)
    BlindCamera(replace(case, scenes=other), _scenes(other, arguments)).record(fresh)
    began = time.perf_counter()
    table = diagnose(campaign, jobs=arguments.jobs, out=diagnosis, calibrate=False)
    named = [row['name'] for row in table['effects']]
    head = f'{seed:4d} {name:22s} {",".join(named) or table["verdict"]:30s}'
    if not table['alternatives'] and not set(named) - {'pose_error'}:
        return f'{head} not calibrated: {table["verdict"]}'
    first = time.perf_counter() - began
    before = realised(fresh, load_effects(diagnosis / 'effects.yaml'))
    try:
        rows = calibrate(diagnosis, campaign, jobs=arguments.jobs, out=calibrated)
    except InputError as error:
        return f'{head} {before:9.2f} {error}'
    after = realised(fresh, load_effects(calibrated / 'effects.yaml'))
    forms = _forms(rows)
    spent = f'{first:.0f} s + {rows["seconds"]:.0f} s'
    predicted = rows['gap']['shrink']
    return f'{head} {before:9.2f} {after:10.2f} {predicted:10.2f}  {forms} ({spent})'


def _forms(rows: dict[str, Any]) -> str:
    texts = [
        f'{row["name"]}: {row["form"]}' if row['taken'] else f'{row["name"]}: kept'
        for row in [*rows['effects'], rows['empirical']]
        if row
    ]
    (chosen,) = (row['effects'] for row in rows['explanations'] if row['chosen'])
    if len(rows['explanations']) > 1:
        texts.append(f'chosen: {", ".join(chosen)}')
    return '; '.join(texts)


def _scenes(key: SceneKey, arguments: argparse.Namespace) -> SceneSet:
    scenes = SceneSet(key, arguments.cache)
    if arguments.mhz is not None:
        mode = replace(scenes.optics.mode, modulation_hz=(arguments.mhz * 1e6,))
        scenes.optics = replace(scenes.optics, mode=mode)
    return scenes


def realised(folder: Path, effects: tuple[Effect, ...]) -> float:
    """Return the fraction of the gap of the recordings in a folder that effects take away."""
    of_camera = [one for one in effects if one.name != 'pose_error']
    rows = []
    for path in sorted(folder.iterdir()):
        recording = load_recording(path)
        inputs = recording.clean_depth, recording.K, recording.stamp_ns, recording.reflectivity
        usecase = recording.usecase or ''
        since = float(recording.extra['uptime'].flat[0])
        old = ageing(one.name for one in of_camera)
        own = tuple(
            replace(one, uptime=since) if one.name in old else one  # type: ignore[call-arg]
            for one in of_camera
        )
        plain, again, better = (
            Camera(usecase, effects=table, seed=seed).capture(*inputs).depth
            for table, seed in (((), 1), ((), 2), (own, 1))
        )
        clean = np.broadcast_to(np.asarray(recording.clean_depth), recording.depth.shape)
        sigma = Camera(usecase).capture(*inputs).sigma
        rows.append(
            [
                _distance(one, other, clean, sigma)
                for one, other in (
                    (plain, again),
                    (recording.depth, plain),
                    (recording.depth, better),
                )
            ]
        )
    floor, without, with_effects = np.mean(rows, axis=0)
    return float(1 - (with_effects - floor) / (without - floor))


def _distance(one: np.ndarray, other: np.ndarray, clean: np.ndarray, sigma: np.ndarray) -> float:
    # Both (T, H, W) metres.
    shift, lost = [], []
    places = np.linspace(0.02, 0.98, 25)
    for a, b in zip(_tiles(one, clean, sigma), _tiles(other, clean, sigma), strict=True):
        mine, its = a[np.isfinite(a)], b[np.isfinite(b)]
        if len(mine) or len(its):
            lost.append(abs(len(mine) - len(its)) / len(a))
        if min(len(mine), len(its)) >= len(places):
            gap = np.quantile(mine, places) - np.quantile(its, places)
            shift.append(float(np.abs(gap).mean()))
    return float(np.mean(shift) + np.mean(lost))


def _tiles(depth: np.ndarray, clean: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    # (tiles, T * 16) errors in sigma.
    frames, height, width = depth.shape
    rows, columns = height // _TILE, width // _TILE
    with np.errstate(invalid='ignore', divide='ignore'):
        error = np.clip((depth - clean) / sigma, -20, 20)
    error = error[:, : rows * _TILE, : columns * _TILE]
    blocks = error.reshape(frames, rows, _TILE, columns, _TILE).transpose(1, 3, 0, 2, 4)
    return np.ascontiguousarray(blocks).reshape(rows * columns, -1)


if __name__ == '__main__':
    main()

"""`flexx2 simulate`: make a recording of a scene."""

import argparse
from pathlib import Path
import zlib

from flexx2_sim_ros.atomic import check_distinct, checked_target
from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.cli.common import messages, print_lines, progress_bar
from flexx2_sim_ros.cli.options import MOST_FRAMES, MOST_SEED, SEEDS, whole_number
from flexx2_sim_ros.effects import aged, Effect, load_effects, load_randomisation
from flexx2_sim_ros.effects.registry import effects_yaml
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError, printable, shown_path
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import DEFAULT_USECASE, Mode
from flexx2_sim_ros.recording import load_scene, RecordingWriter, Scene
import numpy as np
from rich.console import Console

_DEFAULT_FRAMES = 300
_CHUNK = 30
_LATEST = 1e9  # seconds
_LONGEST_UPTIME = 1e6  # seconds
_STARTS = 1_000_000  # seconds from which a scene has its own
# Besides those of the scene itself: with three dimensions, one image a frame.
_MAY_BE_STACKS = {'amplitude', 'known', 'clean_sigma', 'incidence', 'reflectivity_spread'}
OPTIONS = f"""
Read clean depth and write what the camera would have recorded. IN.npz has clean_depth (H, W) or
(T, H, W) in metres, NaN where there is no return, K (3, 3), optionally reflectivity (0..1) and
stamp (T,) in seconds, or stamp_ns. OUT.npz is a recording: depth (T, H, W) float32 metres with NaN
for invalid, clean_depth, K, stamp, usecase, seed, effects if any, and all other keys of IN
(docs/recordings.md).

input IN.npz: scene to read
output OUT.npz: recording to write
--usecase USECASE: mode (default {DEFAULT_USECASE}, or the first of the profile); see flexx2 modes
--profile
--effects FILE: effects beyond the noise model: a YAML file, or the name of a preset, e.g. typical;
    see flexx2 effects
--draw SEED: draw a camera from the distributions of --effects, a file that flexx2 gap randomise
    has written; the same as --effects FILE#SEED
--frames FRAMES: number of frames (default: as many as clean_depth or stamp has, else
    {_DEFAULT_FRAMES})
--seed SEED: seed of the noise (default 0)
--name NAME: camera name; cameras with different names have independent noise
--start SECONDS: stamp of the first frame, if IN has no stamps; noise depends on seed, name and
    stamp (default: whole seconds from a checksum of the scene, so that scenes get different noise)
--uptime SECONDS: time since power-on at the first frame, for warm_up_drift (default: uptime of IN,
    else the parameter of the effect)

example: flexx2 simulate scene.npz out.npz --usecase Mode_5_30fps --frames 300
"""
VALUES = {
    'draw': whole_number(0, MOST_SEED),
    'frames': whole_number(1, MOST_FRAMES),
    'seed': {'type': whole_number(*SEEDS), 'default': 0},
    'name': '',
    'start': float,
    'uptime': float,
}


def run(arguments: argparse.Namespace) -> int:
    """Simulate with a progress bar."""
    for source in (arguments.input, arguments.profile, arguments.effects):
        if source:
            check_distinct(source, arguments.output)
    checked_target(arguments.output)
    if Path(arguments.output).suffix != '.npz':
        raise InputError(f'OUT.npz: must end in .npz, got {shown_path(arguments.output)}')
    scene = load_scene(arguments.input)
    camera, effects = _make_camera(arguments, scene)
    stamps = _stamps(scene, arguments.frames, arguments.start, camera.mode, arguments.input)
    console = messages()
    count = len(stamps)
    _check_images(scene, count, arguments.input)
    # Stamps of a clock are exact in nanoseconds only; the noise depends on them.
    exact = None if scene.stamp_ns is None else scene.stamp_ns[:count]
    times = stamps if exact is None or len(exact) < count else exact
    notes = list(scene.notes)
    if repeated := count - len(np.unique(times)):
        notes.append(
            f'{arguments.input}: stamp: {repeated} of {count} frames have the stamp of another '
            'one, and so its noise'
        )
    print_lines(console, notes, 'yellow')
    invalid = 0
    with (
        RecordingWriter(arguments.output, count, *scene.clean_depth.shape[-2:]) as writer,
        progress_bar(console) as progress,
    ):
        for start in range(0, count, _CHUNK):
            progress('simulating', start / count)
            part = slice(start, min(start + _CHUNK, count))
            frame = camera.capture(
                _frames(scene.clean_depth, part),
                scene.K,
                times[part],
                None if scene.reflectivity is None else _frames(scene.reflectivity, part),
            )
            writer.add_depth(frame.depth)
            invalid += int(np.isnan(frame.depth).sum())
        _write_scene(writer, scene, count, arguments.uptime)
        writer.add_array('stamp', stamps)
        if times is exact:
            writer.add_array('stamp_ns', exact)
        if delay := time_offset_of(effects).delay_ns:
            writer.add_array('received', stamps + delay / 1e9)
        writer.add_array('usecase', camera.usecase)
        writer.add_array('seed', arguments.seed)
        if effects:
            writer.add_array('effects', effects_yaml(effects))
    _say(console, arguments.output, camera, scene, count, invalid)
    return 0


def _check_images(scene: Scene, count: int, path: str) -> None:
    # A recording with fewer images of one kind than frames cannot be read.
    for key in sorted(_MAY_BE_STACKS & scene.extra.keys()):
        value = scene.extra[key]
        if value.ndim == 3 and len(value) < count:
            raise InputError(
                f'{path}: {key}: must have an image for each of the {count} frames, got '
                f'{len(value)}; choose fewer frames with --frames'
            )


def _say(
    console: Console, path: str, camera: Camera, scene: Scene, count: int, invalid: int
) -> None:
    height, width = scene.clean_depth.shape[-2:]
    console.print(
        f'{path}: {count} frames of {width} x {height}, '
        f'{printable(camera.profile.model)}, {camera.usecase}, '
        f'{invalid / (count * height * width):.1%} invalid'
    )
    if invalid == count * height * width:
        mode, depth = camera.mode, scene.clean_depth
        middle = np.median(depth[np.isfinite(depth)]) if np.isfinite(depth).any() else np.nan
        console.print(
            f'clean_depth: must be metres, from {mode.range_min:g} to {mode.range_max:g} in this '
            f'mode, got a median of {middle:.4g}',
            style='yellow',
        )
    if not camera.mode.measured:
        console.print(
            f'{camera.usecase} was not measured: its noise is {camera.mode.noise_words}',
            style='yellow',
        )


def _effects(path: str | None, draw: int | None) -> tuple[Effect, ...]:
    if draw is None:
        return load_effects(path) if path else ()
    if not path:
        raise InputError(
            f'--draw: must come with --effects, a file with distributions, got {draw} alone'
        )
    return load_randomisation(path).draw(1, draw)[0]


def _make_camera(arguments: argparse.Namespace, scene: Scene) -> tuple[Camera, tuple[Effect, ...]]:
    profile = find_profile(arguments.profile)
    usecase = profile.default_usecase if arguments.usecase is None else arguments.usecase
    effects = _effects(arguments.effects, arguments.draw)
    effects = aged(effects, _uptime(scene, arguments.uptime, arguments.input))
    camera = Camera(
        usecase, profile=profile, effects=effects, seed=arguments.seed, name=arguments.name
    )
    return camera, effects


def _write_scene(writer: RecordingWriter, scene: Scene, count: int, uptime: float | None) -> None:
    part = slice(count)
    replaced = {'depth', 'usecase', 'seed', 'effects', 'received'}
    if uptime is not None:
        replaced.add('uptime')
        writer.add_array('uptime', uptime)
    for key, value in scene.extra.items():
        if key == 'uptime' and value.shape not in ((), (count,)):
            value = value[0]  # Of the first frame; stamps say those of the others.
        if key not in replaced:
            writer.add_array(key, _frames(value, part) if key in _MAY_BE_STACKS else value)
    writer.add_array('clean_depth', _frames(scene.clean_depth, part))
    writer.add_array('K', scene.K)
    if scene.reflectivity is not None:
        writer.add_array('reflectivity', _frames(scene.reflectivity, part))


def _uptime(scene: Scene, given: float | None, path: str) -> float | None:
    found = scene.extra.get('uptime') if given is None else np.array(given)
    if found is None:
        return None
    where = f'{path}: uptime' if given is None else '--uptime'
    if found.dtype.kind not in 'fiu' or found.ndim > 1 or not found.size:
        raise InputError(
            f'{where}: must be seconds () or (T,), got {found.dtype} of shape {found.shape}'
        )
    first = float(found.flat[0])
    if not 0 <= first <= _LONGEST_UPTIME:
        raise InputError(f'{where}: must be 0 to {_LONGEST_UPTIME:g} seconds, got {first:g}')
    return first


def _stamps(
    scene: Scene, frames: int | None, start: float | None, mode: Mode, path: str
) -> np.ndarray:
    available = len(scene.clean_depth) if scene.clean_depth.ndim == 3 else None
    if scene.stamp is not None:
        if not len(scene.stamp):
            raise InputError(f'{path}: stamp: must be a time for each frame, got none')
        if available not in (None, len(scene.stamp)):
            raise InputError(
                f'{path}: stamp: must have one value for each of the {available} frames of '
                f'clean_depth, got {len(scene.stamp)}'
            )
        if available is not None or frames is None or frames <= len(scene.stamp):
            available = len(scene.stamp)
    count = frames if frames is not None else available or _DEFAULT_FRAMES
    if available is not None and count > available:
        raise InputError(f'--frames: must be 1 to {available}, got {count}')
    if scene.stamp is not None and count <= len(scene.stamp):
        if start is not None:
            raise InputError(f'--start: must not be given where {path} has stamps, got {start:g}')
        return scene.stamp[:count]
    if start is None:
        start = _own_start(scene)
    if not 0 <= start <= _LATEST:
        raise InputError(f'--start: must be 0 to {_LATEST:g} seconds, got {start:g}')
    return mode.stamps(count, start)


def _own_start(scene: Scene) -> float:
    # Fixed for each scene but different between scenes. Otherwise recordings of several scenes
    # would have the same noise.
    checksum = zlib.crc32(np.ascontiguousarray(scene.clean_depth).data)
    if scene.reflectivity is not None:
        checksum = zlib.crc32(np.ascontiguousarray(scene.reflectivity).data, checksum)
    return float(checksum % _STARTS)


def _frames(array: np.ndarray, part: slice) -> np.ndarray:
    return array[part] if array.ndim == 3 else array

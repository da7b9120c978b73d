"""Find the recordings of a campaign, check them and read them for the diagnosis."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from flexx2_sim_ros.camera import flexx2, Intrinsics, Mode, Profile
from flexx2_sim_ros.errors import each_once, InputError, unquoted
from flexx2_sim_ros.gap.calibration.data import READING
from flexx2_sim_ros.gap.data.frames import (
    Arrival,
    choose_frames,
    find_arrival,
    first_known,
    known_in,
    of_frames,
    still,
)
from flexx2_sim_ros.gap.data.given import given_effects, Table
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.data.units import guessed_scale, largest, reflectivity_from
from flexx2_sim_ros.gap.data.unknown import fill, nearest, plane_shifts
from flexx2_sim_ros.recording import open_recording, Recording, RecordingReader
from flexx2_sim_ros.recording.reader import PROCESSED, uptime_of
from flexx2_sim_ros.recording.truth import read_truth, Truth
import numpy as np


@dataclass(frozen=True)
class Found:
    """
    A recording of the campaign.

    `notes` are its irregularities, for people. `brightest` is its largest floating-point
    amplitude, 0 where no scale has to be guessed; `full_scale` the floating-point amplitude that
    is the camera's full scale (None: guessed from the recording alone, if at all). `arrival` is
    how late its frames arrived, where it says so.
    """

    path: Path
    mode: Mode
    notes: tuple[str, ...]
    brightest: float = 0.0
    full_scale: float | None = None
    arrival: Arrival | None = None


def check(path: Path, profile: Profile | None) -> Found | str:
    """Return the recording if it can be used, otherwise the reason why it cannot."""
    try:
        return _found(open_recording(path, profile=profile), profile)
    except InputError as error:
        return str(error)


def of_one_mode(
    folder: str | Path,
    paths: Sequence[Path],
    checked: Sequence[Found | str],
    full_scale: float | None = None,
) -> tuple[list[Found], list[tuple[str, str]]]:
    """
    Choose the recordings of the mode that most of them have, and give them their full scale.

    `checked` is what `check` says of each path; `full_scale` that of a floating-point amplitude,
    guessed from all these recordings when left out. The second list has names and reasons of those
    left out. Raises `InputError` when none can be used; the message names every file and what is
    wrong.
    """
    found = [one for one in checked if isinstance(one, Found)]
    left_out = [
        (path.name, one) for path, one in zip(paths, checked, strict=True) if isinstance(one, str)
    ]
    if not found:
        raise nothing_left(Path(folder), left_out)
    usual = Counter(one.mode.name for one in found).most_common(1)[0][0]
    left_out += [
        (
            one.path.name,
            f'{one.path}: usecase: must be {usual}, as most recordings of the campaign have, '
            f'got {one.mode.name}',
        )
        for one in found
        if one.mode.name != usual
    ]
    chosen = [one for one in found if one.mode.name == usual]
    # One camera has one scale: a dark scene does not change it.
    brightest = max(one.brightest for one in chosen)
    if full_scale is None and brightest:
        full_scale = guessed_scale(brightest)
    return [replace(one, full_scale=full_scale) for one in chosen], left_out


def nothing_left(folder: Path, left_out: list[tuple[str, str]]) -> InputError:
    """Return the error that says why no recording can be used, each reason once."""
    return InputError(f'{folder}: no recording can be used: ' + '; '.join(each_once(left_out)))


def _found(reader: RecordingReader, profile: Profile | None) -> Found:
    path = reader.path
    if reader.changes:
        raise InputError(f'{reader.changes[0]}; a recording must not change')
    if 'clean_depth' not in reader.layouts and 'clean_depth' not in reader.arrays:
        raise InputError(
            f'{path}: clean_depth: must be the ground truth in metres, (H, W) or (T, H, W), '
            'got none'
        )
    mode, notes = _mode(reader, profile or flexx2())
    if (np.diff(reader.stamp_ns) <= 0).any():
        raise InputError(f'{path}: stamp: must rise from frame to frame, got one that does not')
    height, width = reader.shape[1:]
    try:
        Intrinsics.from_matrix(reader.K, width, height, reader.distortion)
    except InputError as error:
        raise InputError(f'{path}: {error}') from error
    read_truth(path, reader.arrays, reader.shape)
    notes += reader.notes
    if 'processed' in reader.arrays:
        stages = unquoted(str(reader.arrays['processed']))
        notes.append(
            f'{path}: {PROCESSED} {stages} (flexx2 convert): what is named is of the camera and '
            'this processing together; do not process its simulation again'
        )
    arrival = find_arrival(reader, notes)
    return Found(path, mode, tuple(notes), _brightest(reader), arrival=arrival)


def _mode(reader: RecordingReader, profile: Profile) -> tuple[Mode, list[str]]:
    # The mode, and what is to be said about it.
    if reader.usecase is None and len(profile.modes) == 1:
        mode = profile.modes[0]
        return mode, [f'{reader.path}: usecase: not in the file: taken for {mode.name}']
    if reader.usecase is None:
        raise InputError(
            f'{reader.path}: usecase: must be a mode of the {unquoted(profile.model)} (--profile '
            'names another camera), got none (flexx2 convert --usecase MODE adds it)'
        )
    try:
        return profile.mode(reader.usecase), []
    except InputError as error:
        raise InputError(f'{reader.path}: {error}') from error


def _brightest(reader: RecordingReader) -> float:
    # Largest amplitude, 0 where none is used or its whole numbers give the scale.
    if 'reflectivity' in reader.layouts or 'reflectivity' in reader.arrays:
        return 0.0
    whole = reader.arrays.get('amplitude')
    if whole is not None:
        return largest(whole)
    if 'amplitude' not in reader.layouts:
        return 0.0
    return max(map(largest, reader.frames('amplitude')), default=0.0)


def read(found: Found, profile: Profile | None, known: Table | None = None) -> RecordingData:
    """
    Read what the diagnosis needs of a recording. Long recordings are read in part.

    The camera is the Flexx2 if `profile` is None. `known` are effects that the base simulator has,
    parameters by name. Raises `InputError` when the recording cannot be read or compared; the
    message names the file and the key.
    """
    path = found.path
    reader = open_recording(path, profile=profile)
    chosen, fresh = choose_frames(*reader.shape)
    parts, start = [], 0
    for part in reader.chunks(READING.chunk):
        inside = chosen[(chosen >= start) & (chosen < start + len(part.stamp))] - start
        if len(inside):
            parts.append((part, inside))
        start += len(part.stamp)
    key = 'amplitude' if parts[0][0].reflectivity is None else 'reflectivity'
    measured, given, light = (_stack(one, parts) for one in ('depth', 'clean_depth', key))
    assert measured is not None
    assert given is not None
    truth = of_frames(read_truth(path, reader.arrays, reader.shape), chosen)
    notes: list[str] = []
    depth, clean = _depths(found, measured, given, truth.known, notes)
    if clean.ndim == 3:
        there = _there(given, len(chosen))
        first = first_known(clean, known_in(there, clean, truth).known)
        if (clean == first).all(where=np.isfinite(clean)):
            clean, truth = first, still(truth, there)
        else:
            truth = known_in(there & _there(light, len(chosen)), clean, truth)
    if light is not None and clean.ndim == 2 < light.ndim:
        light = light[_there(light, len(chosen))]
    reflectivity = _reflectivity(found, reader.K, key, light, clean, notes)
    clean, reflectivity = _filled(found, clean, reflectivity, truth.known)
    uptime = _uptime(reader, chosen)
    return RecordingData(
        path.name,
        depth,
        clean,
        reflectivity,
        reader.K,
        reader.stamp_ns[chosen],
        fresh,
        uptime,
        found.mode,
        profile,
        tuple(notes),
        truth,
        _plane_shifts(reader, clean, truth),
        given_effects(known or {}, uptime),
    )


def _there(images: np.ndarray | None, count: int) -> np.ndarray:
    # (T,) Which frames have an image of their own, if any has. A bag lacks those of some: they are
    # NaN or, as whole numbers, 0.
    if images is None or images.ndim == 2:
        return np.ones(count, bool)
    there = np.array([np.nan_to_num(image).any() for image in images])
    return there if there.any() else ~there


def _depths(
    found: Found, depth: np.ndarray, clean: np.ndarray, known: np.ndarray | None, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    # Measured and clean depth in metres, NaN where a pixel has no distance or is unknown.
    path, mode = found.path, found.mode
    shape = depth.shape[1:]
    if clean.shape[-2:] != shape:
        raise InputError(
            f'{path}: clean_depth: must have the size of depth, {shape}, got {clean.shape[-2:]}'
        )
    with np.errstate(invalid='ignore', over='ignore'):
        depth = np.where(depth > 0, depth, np.float32(np.nan))
        clean = np.where((clean > 0) & (clean < 1e5), clean, np.nan).astype(np.float32)
    if known is not None:
        if known.ndim > clean.ndim:
            clean = np.broadcast_to(clean, known.shape)
        clean = np.where(known, clean, np.float32(np.nan))
    valid = np.isfinite(depth)
    if not valid.any():
        raise InputError(f'{path}: depth: all pixels of all frames are invalid')
    outside = float(np.mean((depth < mode.range_min) | (depth > mode.range_max), where=valid))
    if outside > READING.outside_range:
        notes.append(
            f'{path}: depth: {outside:.0%} of it is outside {mode.range_min:g} to '
            f'{mode.range_max:g} m, range_m of {mode.name}: simulated depth ends there'
        )
    in_range = (clean >= mode.range_min) & (clean <= mode.range_max)
    if not in_range.any():
        raise InputError(
            f'{path}: clean_depth: must have depths in the range of {mode.name}, '
            f'{mode.range_min:g} to {mode.range_max:g} m, got none'
        )
    if not (valid & in_range).any():
        raise InputError(
            f'{path}: depth, clean_depth: must have pixels that are valid in both, got none'
        )
    return depth, clean


def _reflectivity(
    found: Found,
    K: np.ndarray,
    key: str,
    light: np.ndarray | None,
    clean: np.ndarray,
    notes: list[str],
) -> np.ndarray | None:
    # The given reflectivity, otherwise the one that the amplitude implies; 0 where unknown.
    path, shape = found.path, clean.shape[-2:]
    if light is None:
        return None
    if key == 'amplitude':
        scale = found.full_scale
        reflectivity = reflectivity_from(light, clean, K, found.mode, scale, path, notes)
        if reflectivity is None:
            return None
    else:
        brightest = float(np.nanmax(light, initial=0))
        if brightest > READING.brightest:
            raise InputError(f'{path}: reflectivity: must be 0 to 1, got up to {brightest:g}')
        reflectivity = np.clip(light, 0, 1)
    if reflectivity.shape[-2:] != shape:
        raise InputError(
            f'{path}: reflectivity: must have the size of depth, {shape}, got '
            f'{reflectivity.shape[-2:]}'
        )
    reflectivity = np.nan_to_num(reflectivity).astype(np.float32)
    return reflectivity.mean(axis=0) if clean.ndim == 2 < reflectivity.ndim else reflectivity


def _filled(
    found: Found, clean: np.ndarray, reflectivity: np.ndarray | None, known: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    # Fill unknown pixels: the simulation needs depth everywhere.
    if known is None:
        return clean, reflectivity
    clean = fill(clean, known, found.mode.sensor)
    if reflectivity is not None:
        masks = np.broadcast_to(known, clean.shape)
        if reflectivity.ndim < masks.ndim:
            masks = np.asarray(masks.any(axis=0))
        reflectivity = nearest(reflectivity, masks)
    return clean, reflectivity


def _plane_shifts(reader: RecordingReader, clean: np.ndarray, truth: Truth) -> np.ndarray | None:
    if truth.plane is None or truth.plane_covariance is None:
        return None
    if clean.ndim == 3:
        raise InputError(
            f'{reader.path}: plane: must come with the clean_depth (H, W) of a still scene, got '
            f'one of shape {clean.shape}'
        )
    known = np.ones(clean.shape, bool) if truth.known is None else truth.known
    height, width = clean.shape
    lens = Intrinsics.from_matrix(reader.K, width, height, reader.distortion)
    return plane_shifts(clean, truth.plane, lens, len(truth.plane_covariance) // 3, known)


def _stack(key: str, parts: list[tuple[Recording, np.ndarray]]) -> np.ndarray | None:
    first = getattr(parts[0][0], key)
    if first is None or first.ndim == 2:
        return first
    return np.concatenate([getattr(part, key)[i] for part, i in parts])


def _uptime(reader: RecordingReader, chosen: np.ndarray) -> float | None:
    uptime = uptime_of(reader)
    if uptime is None:
        return None
    if not ((uptime >= 0) & (uptime <= READING.longest_uptime)).all():
        raise InputError(
            f'{reader.path}: uptime: must be seconds since power-on, 0 to '
            f'{READING.longest_uptime:g}, got {uptime.min():g} to {uptime.max():g}'
        )
    return float(uptime[chosen[0]])

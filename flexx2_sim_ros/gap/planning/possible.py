"""Simulations of recordings that could be made next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Camera, Profile
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.gap.data.given import at_size, given_effects, Table
from flexx2_sim_ros.gap.features.simulation import simulate, with_uptime
from flexx2_sim_ros.gap.planning.forecast import Explanation
from flexx2_sim_ros.gap.planning.plan import Plan, PlannedRecording
from flexx2_sim_ros.gap.planning.truths import ALL_KINDS, smaller, TruthKind, write_recording
from flexx2_sim_ros.recording import load_scene
import numpy as np

_FRAMES = 12  # of a scene of the user's own that stands still
_AS_TOLD = TruthKind('own', 'as the file says', fitted=True)  # Registration finds its errors.
_REPLACED = 'depth', 'usecase', 'amplitude'  # keys of a scene's file


@dataclass(frozen=True)
class Possible:
    """
    A recording that could be made next: a name for tables, and words what to set up.

    `path` is its simulated recording, or an existing one. `known` are effects of the camera in
    images of this size, parameters by name. `planned` is the planned recording, if it comes from
    the plan; `repeat`: it repeats an existing recording.
    """

    name: str
    words: str
    kind: TruthKind
    path: Path
    known: Table
    planned: PlannedRecording | None = None
    repeat: bool = False


def usual_kinds(table: Mapping[str, Any]) -> list[str]:
    """Return the kinds of ground truth that the recordings of a ``diagnosis.json`` suggest."""
    truths = [row.get('truth') or {} for row in table['recordings'] if row.get('used')]
    kinds = []
    if any(one.get('planes') for one in truths):
        kinds += ['tape', 'laser']
    if any(one.get('pose') is not None and not one.get('planes') for one in truths):
        kinds.append('scan')
    return kinds or ['exact']


def kinds_named(names: Sequence[str]) -> list[TruthKind]:
    """
    Return the kinds of ground truth with these names, without duplicates.

    Raises `InputError` when a name is not that of a kind.
    """
    by_name = {kind.name: kind for kind in ALL_KINDS}
    for name in names:
        if name not in by_name:
            raise InputError(f'--truth: must be among {", ".join(by_name)}, got {shown(name)}')
    return [by_name[name] for name in dict.fromkeys(names)]


def of_plan(
    folder: Path, plan: Plan, kinds: Sequence[TruthKind], profile: Profile, known: Table, seed: int
) -> list[Possible]:
    """
    Write the plan's recordings with each kind of ground truth that suits them.

    The folder exists. `known` are effects of the camera, parameters by name; `seed` is that of the
    noise.
    """
    lens = smaller(profile.intrinsics, plan.scale)
    known = at_size(known, lens.height, lens.width)
    out = []
    for kind in kinds:
        for planned in plan.recordings:
            if kind.suits(planned):
                path = folder / f'{planned.name}_{kind.name}.npz'
                write_recording(path, plan, planned, profile, kind, known, seed)
                out.append(Possible(planned.name, planned.set_up, kind, path, known, planned))
    return out


def of_scene(
    written: Path, scene_file: Path, usecase: str, profile: Profile, known: Table, seed: int
) -> Possible:
    """
    Write a simulated recording of a scene of the user, an ``.npz`` with ``clean_depth`` and ``K``.

    `written` is the file to write; `profile`, `known` and `seed` are as for `of_plan`. Raises
    `InputError` when the scene cannot be used; the message names its file.
    """
    scene = load_scene(scene_file)
    clean = scene.clean_depth
    count = len(clean) if clean.ndim == 3 else _FRAMES
    stamp = scene.stamp
    if stamp is None or len(stamp) != count:
        stamp = np.arange(count) / profile.mode(usecase).rate_hz
    known = at_size(known, *clean.shape[-2:])
    device = Camera(usecase, profile=profile, effects=given_effects(known), seed=seed)
    depth = device.capture(clean, scene.K, stamp, scene.reflectivity).depth
    extra = scene.extra if clean.ndim == 3 else _of_still_scene(scene.extra)
    arrays: dict[str, Any] = {
        **{key: value for key, value in extra.items() if key not in _REPLACED},
        'clean_depth': clean,
        'K': scene.K,
        'stamp': stamp,
        'depth': depth,
        'usecase': np.array(usecase),
    }
    if scene.reflectivity is not None:
        arrays['reflectivity'] = scene.reflectivity
    np.savez(written, **arrays)
    found = check(written, profile)
    if not isinstance(found, Found):
        raise InputError(found.replace(str(written), shown_path(scene_file)))
    words = f'the scene of {shown_path(scene_file)}'
    return Possible(scene_file.name, words, _AS_TOLD, written, known)


def _of_still_scene(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    # What belongs to single frames becomes that of the scene: it is simulated in another number
    # of frames.
    out = {key: value for key, value in arrays.items() if key != 'received'}
    if 'uptime' in out and out['uptime'].ndim == 1:
        out['uptime'] = out['uptime'][0]
    if 'known' in out and out['known'].ndim == 3:
        out['known'] = np.asarray(out['known'].all(axis=0))
    for key in ('clean_sigma', 'reflectivity_spread'):
        if key in out and out[key].ndim == 3:
            out[key] = out[key].max(axis=0)
    return out


def of_campaign(found: Sequence[Found], known: Table) -> list[Possible]:
    """Return the existing recordings of a campaign, as recordings to repeat."""
    return [
        Possible(one.path.name, 'recorded before', _AS_TOLD, one.path, known, repeat=True)
        for one in found
    ]


@dataclass(frozen=True)
class PredictedView:
    """
    The images that each explanation predicts for a recording, (N, H, W) each.

    * `error`: mean of measured minus clean depth, metres; NaN where one of them is missing.
    * `noise`: standard deviation of that error over frames, metres; NaN as in `error`.
    * `valid`: fraction of frames with a depth; NaN where the ground truth is unknown.
    """

    possible: Possible
    error: np.ndarray
    noise: np.ndarray
    valid: np.ndarray


def look(
    possible: Possible, standing: Sequence[Explanation], profile: Profile, seed: int
) -> PredictedView:
    """Simulate a recording with each explanation that stands."""
    found = check(possible.path, profile)
    if not isinstance(found, Found):
        raise InputError(found)
    recording = read(found, profile, possible.known)
    images = []
    for one in standing:
        depth = simulate(
            recording,
            recording.clean,
            recording.reflectivity,
            with_uptime(one.effects, recording.uptime),
            seed,
        )
        images.append(_images(depth - recording.clean, np.isfinite(depth), recording.truth.known))
    error, noise, valid = (np.array(one) for one in zip(*images, strict=True))
    return PredictedView(possible, error, noise, valid)


def _images(
    error: np.ndarray, seen: np.ndarray, known: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # (H, W) mean and standard deviation of (T, H, W) errors over frames, and the fraction of
    # frames with one; NaN where there is none or the ground truth is unknown.
    if known is None:
        known = np.ones(seen.shape, bool)
    known = np.broadcast_to(known, seen.shape)
    seen = seen & known
    with np.errstate(invalid='ignore', divide='ignore'):
        count = seen.sum(axis=0)
        mean = np.where(seen, error, 0).sum(axis=0) / count
        variance = np.where(seen, (error - mean) ** 2, 0).sum(axis=0) / count
        return mean, np.sqrt(variance), count / known.sum(axis=0)

"""A recording for consumers of depth: measured, and as simulated without and with effects."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from flexx2_sim_ros.camera import Intrinsics, Profile
from flexx2_sim_ros.consumers.comparison import AGAIN, ALL, REAL, SIMULATED
from flexx2_sim_ros.consumers.consumer import CameraView
from flexx2_sim_ros.consumers.ground import best_centre, find_ground, mounted
from flexx2_sim_ros.consumers.running import ConsumerViews
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.frames import at_frame
from flexx2_sim_ros.gap.data.given import Table
from flexx2_sim_ros.gap.features.simulation import PlacedScene, with_uptime
from flexx2_sim_ros.gap.forms.looked import registered, Settings
from flexx2_sim_ros.recording import open_recording
import numpy as np

# The last frames of a still recording, as many as `flexx2 batch` puts into a height grid; and
# poses of a moving camera, whose recordings do not say how the camera moved: one frame each.
_FRAMES, _POSES = 8, 4
_SEED = 700  # apart from the seeds of the diagnosis


@dataclass(frozen=True)
class Known:
    """
    What a diagnosis knows of its camera and its recordings.

    * `effects`: the diagnosed effects: parameters by name.
    * `fitted`: checksums of the recordings that the effects were fitted to.
    * `without`: by checksum: the effects as fitted without this recording.
    * `delay`: how late images arrive, seconds; 0 if that is not known.
    """

    effects: Settings
    fitted: frozenset[str]
    without: dict[str, Settings]
    delay: float = 0.0


def render(
    found: Found,
    profile: Profile | None,
    known: Table,
    seed: int,
    prior: tuple[float, ...],
    diagnosed: Known,
    mounting: tuple[float, float] | None,
) -> tuple[ConsumerViews, str] | str:
    """
    Simulate a recording without effects (twice), with each effect alone and with all of them.

    All have common random numbers. Return the renditions by name, and ``other recordings`` if the
    effects were not fitted to this one, or ``this recording``; or the reason why the recording
    cannot be used. `mounting` is as for `cost`.
    """
    try:
        recording = read(found, profile, known)
        effects = diagnosed.without.get(recording.checksum, diagnosed.effects)
        own = with_uptime(effects, recording.uptime)
        _, _, scene = registered(recording, np.array(prior), own)
    except InputError as error:
        return str(error)
    distortion = open_recording(found.path, profile=profile).distortion
    poses = list(_poses(scene, distortion, mounting))
    if not poses:
        return (
            f'{found.path}: clean_depth: must show the ground, a plane that faces up; got none '
            '(flexx2 gap cost --mounting gives the height and angle of the camera)'
        )
    first = seed * 1000 + _SEED
    plain = scene.simulate({}, first)
    # An effect that depends on an uptime that the recording does not have changes nothing.
    alone = {
        name: scene.simulate({name: own[name]}, first) if name in own else plain
        for name in effects
    }
    seen = {
        REAL: recording.depth,
        SIMULATED: plain,
        AGAIN: scene.simulate({}, first + 1),
        **alone,
        ALL: scene.simulate(own, first),
    }
    views = ConsumerViews(
        recording.name,
        tuple(view for view, *_ in poses),
        {name: tuple(_seen(depth, *pose) for pose in poses) for name, depth in seen.items()},
    )
    fitted = recording.checksum in diagnosed.fitted - diagnosed.without.keys()
    return views, 'this recording' if fitted else 'other recordings'


def _seen(
    depth: np.ndarray, view: CameraView, frames: np.ndarray, known: np.ndarray
) -> CameraView:
    # What a consumer sees of a recording's depth: no pixel whose truth is unknown.
    return replace(view, depth=np.where(known, depth[frames], np.float32(np.nan)))


def _poses(
    scene: PlacedScene, distortion: tuple[float, ...], mounting: tuple[float, float] | None
) -> Iterator[tuple[CameraView, np.ndarray, np.ndarray]]:
    # Of each pose of the camera whose ground is known: the true depth from there, which frames
    # come from there, and (H, W) where the truth is known.
    clean, mask, mode = scene.placed.clean, scene.placed.known, scene.recording.mode
    count = len(scene.recording.depth)
    if scene.moving:
        evenly = np.linspace(0, count - 1, min(count, _POSES)).round().astype(int)
        chosen = [np.array([t]) for t in evenly]
    else:
        chosen = [np.arange(max(count - _FRAMES, 0), count)]
    height, width = clean.shape[-2:]
    lens = Intrinsics.from_matrix(scene.recording.K, width, height, distortion)
    for frames in chosen:
        image, known = at_frame(clean, frames[0]), at_frame(mask, frames[0])
        known = np.ones(image.shape, bool) if known is None else known.copy()
        edge = scene.placed.border
        if edge:  # The given pose did not show it.
            known[:edge], known[-edge:], known[:, :edge], known[:, -edge:] = (False,) * 4
        inside = known & (image >= mode.range_min) & (image <= mode.range_max)
        true = np.where(inside, image, np.float32(np.nan)).astype(np.float32)
        standing = find_ground(true, lens, mode.sensor) if mounting is None else mounted(*mounting)
        if standing is not None:
            depth = np.broadcast_to(true, (len(frames), height, width))
            view = CameraView(depth, lens, mode, standing.rotation, standing.position, None)
            points = np.concatenate([view.points(t) for t in range(len(frames))])
            yield replace(view, centre=best_centre(points)), frames, known

"""What the fit of a curve needs of one recording: errors on surfaces, and their covariates."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.effects import Effect, loadable
from flexx2_sim_ros.effects.grazing_dropout import log_slant
from flexx2_sim_ros.effects.line_of_sight import log_amplitude
from flexx2_sim_ros.effects.patch import ResidualPatch
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.surfaces import returned_light
from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.frames import at_frame, looked_at, seen_at, surface_of
from flexx2_sim_ros.gap.data.given import together
from flexx2_sim_ros.gap.data.pose import base_camera, pose_columns
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.physics.frame_state import Stage
from flexx2_sim_ros.physics.geometry import ray_length
import numpy as np


@dataclass(frozen=True)
class Samples:
    """
    Pixels of one recording on surfaces away from edges, some of its rows and columns.

    * `motion`: (M,) pose and planes at which the errors were taken, as for `registration.place`.
    * `error`: (N,) metres, measured less clean depth; of a still scene the mean over frames.
    * `sigma`: (N,) metres, of the errors: noise, and the bias that does not matter.
    * `own`: (M, N) metres for each unit of ``motion``.
    * `spread`: (M, M) factor of the covariance of ``motion``, as from `prior.factor`.
    * `length`: (N,) length of each pixel's ray, as a multiple of its depth.
    * `distance`: (N,) metres along the ray.
    * `light`: (N,) natural logarithm of the amplitude in 1/m^2.
    * `uptime`: (N,) seconds since power-on; NaN if the recording does not say.
    * `place`: (N,) index into the flat (F, H, W) images of `shift_of`.
    * `slopes`: by effect on geometry: (K, N) metres for a change of each of its parameters by half
      of its bounds, as from `geometry.slopes_of`.
    """

    motion: np.ndarray
    error: np.ndarray
    sigma: np.ndarray
    own: np.ndarray
    spread: np.ndarray
    length: np.ndarray
    distance: np.ndarray
    light: np.ndarray
    uptime: np.ndarray
    place: np.ndarray
    slopes: dict[str, np.ndarray] = field(default_factory=dict)


def frames_of(recording: RecordingData) -> np.ndarray:
    """Return which frames of a recording are looked at, see `looked_at`."""
    return np.array(looked_at(len(recording.depth), recording.still))


def shift_of(scene: PlacedScene, effects: Any) -> np.ndarray:
    """
    Return what effects change in the depth of a recording's frames, (F, H, W) metres.

    The frames are those of `frames_of`; 0 where it cannot be said. The effects that the scene
    takes as given are part of what changes.
    """
    recording, placed = scene.recording, scene.placed
    frames = frames_of(recording)
    every = [
        one.bias_alone() if isinstance(one, ResidualPatch) else one
        for one in together(recording.given, effects)
        if _shifts_surfaces(one, scene.moving)
    ]
    if not every:
        return np.zeros((len(frames), *placed.clean.shape[-2:]), np.float32)
    # What motion changes depends on the frames before, not only on those that are looked at.
    history = scene.moving and any(one.needs_motion or _lags(one) for one in every)
    seen = np.arange(frames[-1] + 1) if history else frames
    clean, light = (at_frame(one, seen) for one in (placed.clean, placed.reflectivity))
    camera = base_camera(recording.mode, recording.profile, 0, recording.name)
    common = CommonRandomNumbers(camera, clean, recording.K, recording.stamp[seen], light)
    change = common.depth(every) - common.depth(())
    return np.nan_to_num(change[frames] if history else change)


def shift_alike(one: Mapping[str, Any], other: Mapping[str, Any], moving: bool) -> bool:
    """Say whether all settings of effects that shift surfaces are the same objects in both."""
    names = {*shifters(one, moving), *shifters(other, moving)}
    return all(one.get(name) is other.get(name) for name in names)


def shifters(effects: Iterable[str], moving: bool) -> list[str]:
    """Return which effects shift surfaces in a still or moving scene."""
    return [name for name in effects if _shifts_surfaces(loadable()[name], moving)]


def _shifts_surfaces(effect: Effect | type[Effect], moving: bool) -> bool:
    # Later stages add noise or lose pixels, but shift no surface. An empirical correction does,
    # and so does a filter over frames while the camera moves.
    return (
        effect.stage < Stage.NOISE
        or effect.name == ResidualPatch.name
        or (moving and _lags(effect))
    )


def _lags(effect: Effect | type[Effect]) -> bool:
    return effect.filters and effect.keeps


def samples_of(scene: PlacedScene, motion: np.ndarray, spread: np.ndarray) -> Samples:
    """Return the samples of a recording at a pose; ``spread`` as in `Samples`."""
    parts = [_frame(scene, i, int(t)) for i, t in enumerate(frames_of(scene.recording))]
    columns: dict[str, Any] = {
        name: np.concatenate([one[name] for one in parts], axis=-1) for name in parts[0]
    }
    return Samples(motion=motion, spread=spread, **columns)


def _frame(scene: PlacedScene, index: int, t: int) -> dict[str, np.ndarray]:
    # Those of one frame.
    recording = scene.recording
    clean = at_frame(scene.placed.clean, t)
    cover = scene.covariates[t if len(scene.covariates) > 1 else 0]
    error, count = mean_error(scene, t)
    noise = cover.sigma / np.sqrt(count)
    sigma = np.hypot(noise, FEATURES.tolerances['bias'] * cover.sigma)
    limit = REGISTRATION.outlier_sigmas * cover.sigma + REGISTRATION.outlier
    some = _some(clean.shape)
    own = pose_columns(clean, recording.K, recording.mode.sensor)
    if recording.plane_shifts is not None:
        own = np.concatenate([own, recording.plane_shifts[:, ::2, ::2]])
    own = own[:, :: some // 2, :: some // 2]
    light = covariates_at(scene, t)['light']
    with np.errstate(invalid='ignore'):
        good = (cover.inside & np.isfinite(error) & (np.abs(error) < limit))[::some, ::some]
    good &= np.isfinite(own).all(axis=0) & np.isfinite(light[::some, ::some])
    seconds = (int(recording.stamp[t]) - int(recording.stamp[0])) * 1e-9
    uptime = np.nan if recording.uptime is None else recording.uptime + seconds
    images = {
        'error': error,
        'sigma': sigma,
        'length': cover.ray,
        'distance': clean * cover.ray,
        'light': light,
        'uptime': np.full(clean.shape, uptime),
    }
    place = np.arange(clean.size).reshape(clean.shape)[::some, ::some][good]
    return {
        **{name: one[::some, ::some][good].astype(np.float64) for name, one in images.items()},
        'own': own[:, good].astype(np.float64),
        'place': index * clean.size + place,
    }


def _some(shape: tuple[int, ...]) -> int:
    # One of so many rows and columns: an even number, so that about as many pixels of a large
    # image are taken as of a small one.
    return 2 * max(round(max(shape) / FORMS.samples / 2), 1)


def mean_error(scene: PlacedScene, t: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Return measured less clean depth of a frame, or the mean over all frames of a still scene.

    It is (H, W) metres, NaN where fewer than half of the frames are valid; beside it (H, W) how
    many are, at least one.
    """
    seen, count = seen_at(scene.recording.depth, t, not scene.moving)
    return seen - at_frame(scene.placed.clean, t), count


def covariates_at(scene: PlacedScene, t: int) -> dict[str, np.ndarray]:
    """
    Return what curves of effects are over besides the distance, of a frame's pixels, (H, W) each.

    These are ``light``, the natural logarithm of the amplitude that the simulator has,
    ``incidence``, the angle between ray and surface normal, degrees, and ``slant``, see
    `log_slant`.
    """
    clean, albedo = (at_frame(one, t) for one in (scene.placed.clean, scene.placed.reflectivity))
    cosine = surface_of(clean, scene.recording.K, scene.recording.mode.sensor).cos_incidence
    albedo = np.float32(1) if albedo is None else np.clip(albedo, 0, 1)
    with np.errstate(divide='ignore', invalid='ignore'):
        inverse = (1 / clean).astype(np.float32)
        light = on_images(returned_light)(albedo, cosine, inverse)
    return {
        'light': log_amplitude(np.asarray(light)),
        'incidence': np.degrees(np.arccos(np.clip(cosine, 0, 1))),
        'slant': log_slant(cosine, clean * ray_length(scene.recording.K, clean.shape)),
    }

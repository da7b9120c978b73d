"""A recording, and the pose of its camera that explains it best."""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import NamedTuple

from flexx2_sim_ros.camera import flexx2, Mode, Profile
from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.effects.between import between
from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.data.axes import Axes, axes_of
from flexx2_sim_ros.gap.data.covariates import look_at
from flexx2_sim_ros.gap.data.frames import at_frame, seen_at
from flexx2_sim_ros.gap.data.jump_shift import jumps_of
from flexx2_sim_ros.gap.data.pose import (
    base_camera,
    Differences,
    fit_plane_motion,
    moved,
    unknown_border,
)
from flexx2_sim_ros.gap.data.prior import POSE, spread_of
from flexx2_sim_ros.recording.truth import Truth
import numpy as np

_LATE, _LATEST = REGISTRATION.late, REGISTRATION.latest


@dataclass(frozen=True)
class RecordingData:
    """
    What the diagnosis needs of a recording.

    * `name`: the file's.
    * `depth`: (T, H, W) float32 metres, NaN where invalid.
    * `clean`: (H, W) or (T, H, W) float32.
    * `reflectivity`: like ``clean``.
    * `K`: (3, 3) camera matrix.
    * `stamp`: (T,) int64 nanoseconds.
    * `fresh`: (T,) bool, frames that do not directly follow the frame before them.
    * `uptime`: seconds since power-on at the first of the frames.
    * `notes`: what was converted or assumed.
    * `truth`: how well ``clean`` is known. Where it is unknown (``truth.known``), it is filled.
    * `plane_shifts`: as from `planes.plane_shifts`; None without planes.
    * `given`: effects that the base simulator has, as from `given.given_effects`.
    """

    name: str
    depth: np.ndarray
    clean: np.ndarray
    reflectivity: np.ndarray | None
    K: np.ndarray  # noqa: N815
    stamp: np.ndarray
    fresh: np.ndarray
    uptime: float | None
    mode: Mode
    profile: Profile | None
    notes: tuple[str, ...] = ()
    truth: Truth = Truth()
    plane_shifts: np.ndarray | None = None
    given: tuple[Effect, ...] = ()

    @property
    def still(self) -> bool:
        """Return whether one clean image is that of all frames."""
        return self.clean.ndim == 2

    @property
    def axes(self) -> Axes:
        """Return the camera's axes."""
        return axes_of(self.profile or flexx2())

    @property
    def checksum(self) -> str:
        """Return the SHA-256 of the measured depth, whatever the file's name and format are."""
        return sha256(np.nan_to_num(self.depth).astype('<f4').tobytes()).hexdigest()


@dataclass(frozen=True)
class Placed:
    """
    A recording's scene from the fitted pose of its camera.

    All images are (H, W) or (T, H, W): `clean` float32 metres, `reflectivity` or None, and
    `known`, bool, where `clean` is known; None for everywhere. `border` is the width of the
    image's border that is filled because the given pose did not show it, pixels.
    """

    clean: np.ndarray
    reflectivity: np.ndarray | None
    known: np.ndarray | None
    border: int


def place(recording: RecordingData, motion: np.ndarray) -> Placed:
    """
    Return a recording's scene from another pose and with its planes moved.

    `motion` is (6 + 3 P,) by which the camera is moved, metres and degrees, and the planes, metres
    and radians.
    """
    K, mode, pose = recording.K, recording.mode, motion[:POSE]  # noqa: N806
    shown = _with_planes(recording, motion)
    clean, reflectivity = moved(shown, recording.reflectivity, K, mode, pose)
    return Placed(
        clean,
        reflectivity,
        _known_from(recording.truth.known, recording.clean, recording, pose),
        unknown_border(pose, clean, K),
    )


def _with_planes(recording: RecordingData, motion: np.ndarray) -> np.ndarray:
    # Clean depth with the planes moved.
    if recording.plane_shifts is None or not motion[POSE:].any():
        return recording.clean
    shift = np.tensordot(motion[POSE:], recording.plane_shifts, axes=1)
    return np.asarray(recording.clean + shift.astype(np.float32))


def _known_from(
    known: np.ndarray | None, clean: np.ndarray, recording: RecordingData, pose: np.ndarray
) -> np.ndarray | None:
    # The mask moves with the surfaces, like reflectivity.
    if known is None or not pose.any():
        return known
    mask = np.broadcast_to(known, clean.shape).astype(np.float32)
    _, there = moved(clean, mask, recording.K, recording.mode, pose)
    return np.asarray(there) > 0.5


def register(
    recording: RecordingData,
    prior: np.ndarray,
    waves: Sequence[float] = (),
    latency: float = 0.0,
    line: tuple[float, float] = (0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray]:
    """
    Find the small motion of the camera, and of planes, that best explains a recording.

    Return (6 + 3 P,) the motion: metres and degrees of the camera, metres and radians of the P
    planes; and the part of it that remains under a prior three times as stiff.

    * `prior`: (6,) standard deviations of a pose whose covariance the recording does not give,
      metres and degrees.
    * `waves`: periods along the ray of biases that the recordings have, metres: a pose error is
      not to take them up.
    * `latency`: age of the images of a moving scene at their stamps to start from, seconds.
    * `line`: metres, and fraction, by which the recordings' depths are too long, about; a pose is
      not to take that up.
    """
    still = recording.still
    chosen = [0] if still else _chosen(recording)
    spread = spread_of(recording.truth, prior)
    whiten = np.linalg.pinv(spread)
    shifts = recording.plane_shifts
    shifts = np.zeros((0, *recording.clean.shape[-2:])) if shifts is None else shifts
    motion, sure, lateness = np.zeros(len(spread)), np.zeros(len(spread)), latency
    biases: _Biases | None = None
    for _ in range(REGISTRATION.rounds):
        shown = (
            _with_planes(recording, motion)
            if still
            else frames_between(recording, chosen, lateness)
        )
        clean, reflectivity = moved(
            shown,
            at_frame(recording.reflectivity, chosen),
            recording.K,
            recording.mode,
            motion[:POSE],
        )
        if biases is None:  # Computed once: a small motion hardly changes them.
            biases = _typical_biases(recording, clean, reflectivity, chosen, line)
        late = None if still else images_by_latency(recording, chosen, lateness)
        step, amounts, sure = fit_plane_motion(
            _differences(recording, shown, clean, chosen, motion, biases, late, line),
            recording.K,
            spread,
            shifts,
            motion,
            recording.profile or flexx2(),
            waves,
        )
        bound = REGISTRATION.bound
        motion = spread @ np.clip(whiten @ (motion + step), -bound, bound)
        if late is not None:
            reach = max(_LATEST, 1.5 * abs(latency))
            lateness = float(np.clip(lateness + _LATE * amounts[-1], -reach, reach))
    return motion, sure


def _chosen(recording: RecordingData) -> list[int]:
    # Frames of a moving recording, spread over those that show what is known.
    frames, known = np.arange(len(recording.depth)), recording.truth.known
    if known is not None and known.ndim == 3 and known.any():
        frames = np.flatnonzero(known.any(axis=(1, 2)))
    first, last = min(REGISTRATION.lead, len(frames) - 1), max(len(frames) - 2, 0)
    places = {round(x) for x in np.linspace(first, last, REGISTRATION.frames)}
    return [int(frames[place]) for place in sorted(places)]


class _Biases(NamedTuple):
    # (N, H, W) metres each: simulated depth, with each effect that is like a pose error at typical
    # size, and with the given effects, from common random numbers.
    plain: np.ndarray
    changed: list[np.ndarray]
    given: np.ndarray


def _differences(
    recording: RecordingData,
    shown: np.ndarray,
    clean: np.ndarray,
    chosen: Sequence[int],
    motion: np.ndarray,
    biases: _Biases,
    late: tuple[np.ndarray, np.ndarray] | None,
    line: tuple[float, float],
) -> list[Differences]:
    # Each frame with where it differs from its clean depth, and with what each bias and latency
    # changes. What the given effects change is subtracted.
    still = clean.ndim == 2
    known, accuracy = (
        at_frame(one, list(chosen)) for one in (recording.truth.known, recording.truth.clean_sigma)
    )
    known = _known_from(known, shown, recording, motion[:POSE])
    frames = []
    for i, t in enumerate(chosen):
        image = clean if still else clean[i]
        mask = at_frame(known, i)
        scene = look_at(
            image, None, 0.0, None, recording.K, recording.mode, recording.axes, known=mask
        )
        sigma = scene.sigma
        if accuracy is not None:
            sigma = np.hypot(sigma, at_frame(accuracy, i))
        real, _ = seen_at(recording.depth, t, still)
        with np.errstate(invalid='ignore'):
            error = real - image - np.nan_to_num(biases.given[i] - biases.plain[i])
            limit = REGISTRATION.outlier_sigmas * sigma + REGISTRATION.outlier
            near = np.abs(error - line[0] - line[1] * image) < limit
            error = np.where(scene.inside & near, error, np.nan)
        changes = [(biases.plain[i], one[i]) for one in biases.changed]
        other = [np.nan_to_num(one - plain) for plain, one in changes]
        if late is not None:
            longer, shorter = late
            changes.append((shorter[i], longer[i]))
            other.append(_same_surface(shorter[i], longer[i]))
        jumps = jumps_of(image, sigma, scene.compared, recording.K, recording.mode.sensor)
        shifts = np.nan_to_num([jumps.shift(one) - jumps.shift(plain) for plain, one in changes])
        by_given = jumps.shift(biases.given[i]) - jumps.shift(biases.plain[i])
        moved_by = jumps.shift(real) - by_given
        others = np.array(other)
        frames.append(Differences(error, image, sigma, others, jumps.slopes, moved_by, shifts))
    return frames


def frames_between(recording: RecordingData, chosen: Sequence[int], lateness: float) -> np.ndarray:
    """Return (N, H, W) clean depth of a moving scene, some seconds before the frames' stamps."""
    out = []
    for t in chosen:
        moment = int(recording.stamp[t]) - round(lateness * 1e9)
        i = int(np.clip(np.searchsorted(recording.stamp, moment), 1, len(recording.stamp) - 1))
        start, end = int(recording.stamp[i - 1]), int(recording.stamp[i])
        fraction = (moment - start) / max(end - start, 1)
        out.append(
            between(
                recording.clean[i - 1],
                recording.clean[i],
                float(np.clip(fraction, 0, 1.5)),
                (end - start) * 1e-9,
            )
        )
    return np.array(out)


def images_by_latency(
    recording: RecordingData, chosen: Sequence[int], lateness: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, H, W) clean depth twice: latency longer and shorter by half of its step."""
    reach = _LATE / 2
    longer, shorter = (
        frames_between(recording, chosen, lateness + sign * reach) for sign in (1, -1)
    )
    return longer, shorter


def change_by_latency(
    recording: RecordingData, chosen: Sequence[int], lateness: float
) -> np.ndarray:
    """Return (N, H, W) metres, the change of depth by a time offset of `REGISTRATION.late`."""
    longer, shorter = images_by_latency(recording, chosen, lateness)
    return _same_surface(shorter, longer)


def _same_surface(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    # Change of depth from one to the other where both show the same surface, 0 elsewhere.
    with np.errstate(invalid='ignore'):
        change = other - one
        return np.where(np.abs(change) < REGISTRATION.same_surface * one, change, np.float32(0))


def _typical_biases(
    recording: RecordingData,
    clean: np.ndarray,
    reflectivity: np.ndarray | None,
    chosen: Sequence[int],
    line: tuple[float, float],
) -> _Biases:
    common = CommonRandomNumbers(
        base_camera(recording.mode, recording.profile, 0, recording.name),
        clean,
        recording.K,
        recording.stamp[list(chosen)],
        reflectivity,
    )
    plain, *changed = (
        common.depth(effects)
        for effects in ((), *_like_a_pose(bool(recording.mode.modulation_hz)))
    )
    given = common.depth(recording.given) if recording.given else plain
    offset, scale = line
    changed += [plain + offset] * bool(offset) + [(1 + scale) * plain] * bool(scale)
    return _Biases(plain, changed, given)


def _like_a_pose(modulation: bool) -> list[dict[str, dict[str, float]]]:
    # Effects that also shift whole surfaces: effects on light first, then on geometry.
    kinds = sorted(registry().values(), key=lambda kind: -kind.stage)
    return [
        {kind.name: dict(values)}
        for kind in kinds
        if modulation or not kind.needs_modulation
        for values in kind.like_a_pose
    ]

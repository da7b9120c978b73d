"""A recording, and where its camera must have been."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.camera import flexx2, Mode, Profile
from flexx2_sim_ros.camera.common_random_numbers import CommonRandomNumbers
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.between import between
from flexx2_sim_ros.gap.calibration.constants import REGISTRATION
from flexx2_sim_ros.gap.data.covariates import Axes, axes_of, look_at
from flexx2_sim_ros.gap.data.pose import base_camera, fit_plane_motion, moved
import numpy as np

_LATE, _LATEST = REGISTRATION.late, REGISTRATION.latest


@dataclass(frozen=True)
class RecordingData:
    """
    What is needed of a recording.

    Attributes
    ----------
    name : str
        The file's.
    depth : numpy.ndarray
        (T, H, W) float32 metres, NaN where invalid.
    clean : numpy.ndarray
        (H, W) or (T, H, W) float32.
    reflectivity : numpy.ndarray or None
        Like ``clean``.
    K : numpy.ndarray
    stamp : numpy.ndarray
        (T,) int64 nanoseconds.
    fresh : numpy.ndarray
        (T,) bool, frames that do not follow the one before.
    uptime : float or None
        Seconds since power-on at the first of the frames.
    mode : Mode
    profile : Profile or None
    notes : tuple of str
        What was converted or assumed.

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

    @property
    def axes(self) -> Axes:
        """Return the camera's axes."""
        return axes_of(self.profile or flexx2())


def register(recording: RecordingData, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Find the small motion that best explains a recording.

    Parameters
    ----------
    recording : RecordingData
        The recording.
    prior : numpy.ndarray
        (6,) standard deviations, metres and degrees.

    Returns
    -------
    tuple of numpy.ndarray
        (6,) metres and degrees; and what of it is beyond doubt.

    """
    still = recording.clean.ndim == 2
    count = len(recording.depth)
    chosen = (
        [0]
        if still
        else sorted(
            {
                round(x)
                for x in np.linspace(
                    min(REGISTRATION.lead, count - 1), max(count - 2, 0), REGISTRATION.frames
                )
            }
        )
    )
    pose, sure, lateness = np.zeros(6), np.zeros(6), 0.0
    others: list[np.ndarray] = []
    for _ in range(REGISTRATION.rounds):
        shown = recording.clean if still else _shown(recording, chosen, lateness)
        clean, reflectivity = moved(
            shown,
            recording.reflectivity
            if still or recording.reflectivity is None or recording.reflectivity.ndim == 2
            else recording.reflectivity[chosen],
            recording.K,
            recording.mode,
            pose,
        )
        if not others:  # A small motion hardly changes them.
            others = _typical_biases(recording, clean, reflectivity, chosen)
        late = [] if still else [_late(recording, chosen, lateness)]
        errors, depths, sigmas = [], [], []
        for i, t in enumerate(chosen):
            image = clean if still else clean[i]
            scene = look_at(image, None, 0.0, None, recording.K, recording.mode, recording.axes)
            with np.errstate(invalid='ignore'):
                if still:
                    valid = np.isfinite(recording.depth).sum(axis=0)
                    real = np.nansum(recording.depth, axis=0) / np.maximum(valid, 1)
                    real = np.where(valid > 0.5 * count, real, np.nan)
                else:
                    real = recording.depth[t]
                error = real - image
                limit = REGISTRATION.outlier_sigmas * scene.sigma + REGISTRATION.outlier
                errors.append(np.where(scene.inside & (np.abs(error) < limit), error, np.nan))
            depths.append(image)
            sigmas.append(scene.sigma)
        step, amounts, sure = fit_plane_motion(
            np.array(errors),
            np.array(depths),
            np.array(sigmas),
            recording.K,
            prior,
            np.stack([*others, *late], axis=1),
            pose,
            recording.profile or flexx2(),
        )
        pose = np.clip(pose + step, -REGISTRATION.bound * prior, REGISTRATION.bound * prior)
        if late:
            lateness = float(np.clip(lateness + _LATE * amounts[-1], -_LATEST, _LATEST))
    return pose, sure


def _shown(recording: RecordingData, chosen: Sequence[int], lateness: float) -> np.ndarray:
    # (N, H, W) clean depth as it was so many seconds before the stamps.
    out = []
    for t in chosen:
        moment = int(recording.stamp[t]) - round(lateness * 1e9)
        i = int(np.clip(np.searchsorted(recording.stamp, moment), 1, len(recording.stamp) - 1))
        start, end = int(recording.stamp[i - 1]), int(recording.stamp[i])
        share = (moment - start) / max(end - start, 1)
        out.append(
            between(
                recording.clean[i - 1],
                recording.clean[i],
                float(np.clip(share, 0, 1.5)),
                (end - start) * 1e-9,
            )
        )
    return np.array(out)


def _late(recording: RecordingData, chosen: Sequence[int], lateness: float) -> np.ndarray:
    # (N, H, W) metres, what being later by _LATE changes.
    reach = _LATE / 2
    before, after = (_shown(recording, chosen, lateness + sign * reach) for sign in (1, -1))
    with np.errstate(invalid='ignore'):
        change = before - after
        return np.where(np.abs(change) < REGISTRATION.same_surface * after, change, np.float32(0))


def _typical_biases(
    recording: RecordingData,
    clean: np.ndarray,
    reflectivity: np.ndarray | None,
    chosen: Sequence[int],
) -> list[np.ndarray]:
    # (N, H, W) metres each, without any noise of their own.
    common = CommonRandomNumbers(
        base_camera(recording.mode, recording.profile, 0, recording.name),
        clean,
        recording.K,
        recording.stamp[list(chosen)],
        reflectivity,
    )
    base, *changed = (
        common.depth(effects)
        for effects in ((), *_like_a_pose(bool(recording.mode.modulation_hz)))
    )
    return [np.nan_to_num(one - base) for one in changed]


def _like_a_pose(modulation: bool) -> list[dict[str, dict[str, float]]]:
    # What else shifts whole surfaces: by light first, then by geometry.
    kinds = sorted(registry().values(), key=lambda kind: -kind.stage)
    return [
        {kind.name: dict(values)}
        for kind in kinds
        if modulation or not kind.needs_modulation
        for values in kind.like_a_pose
    ]

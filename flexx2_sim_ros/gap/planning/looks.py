"""The images that each explanation predicts for a recording."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.gap.features.simulation import simulate, with_uptime
from flexx2_sim_ros.gap.planning.explanations import Explanation
from flexx2_sim_ros.gap.planning.possible import Possible
import numpy as np


@dataclass(frozen=True)
class PredictedView:
    """
    The images that each explanation predicts for a recording.

    Attributes
    ----------
    possible : Possible
        The recording.
    error : numpy.ndarray
        (N, H, W) mean of measured minus clean depth, metres; NaN where one of them is missing.
    noise : numpy.ndarray
        (N, H, W) standard deviation of that error over frames, metres; NaN as in `error`.
    valid : numpy.ndarray
        (N, H, W) fraction of frames with a depth; NaN where the ground truth is unknown.

    """

    possible: Possible
    error: np.ndarray
    noise: np.ndarray
    valid: np.ndarray


def look(
    possible: Possible, standing: Sequence[Explanation], profile: Profile, seed: int
) -> PredictedView:
    """
    Simulate a recording with each explanation.

    Parameters
    ----------
    possible : Possible
        The recording.
    standing : sequence of Explanation
        The explanations.
    profile : Profile
        The camera.
    seed : int
        Seed of the noise.

    """
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

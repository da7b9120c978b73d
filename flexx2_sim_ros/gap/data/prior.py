"""The prior of a recording's own errors: errors of its pose and of its planes."""

from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH, REGISTRATION
from flexx2_sim_ros.recording.truth import Truth
import numpy as np

POSE = 6
USUAL = GROUND_TRUTH.usual  # metres and degrees


def prior_from_scatter(poses: np.ndarray) -> np.ndarray:
    """
    Return the prior of poses of which nothing is stated, (6,) metres and degrees, from (R, 6).

    `poses` are what registration found, of at least two recordings. They scatter by what they are
    wrong by, alike in all directions, and along one of them by what the camera does besides, such
    as a drift of its depth. So the middle one of three directions counts.
    """
    scatter = np.median(poses.std(axis=0, ddof=1).reshape(2, 3), axis=1)
    return np.repeat(np.maximum(scatter, GROUND_TRUTH.least_scatter), 3)


def covariance_of(truth: Truth) -> np.ndarray | None:
    """
    Return the prior covariance of a recording's own errors, if its ground truth gives one.

    It is (6 + 3 P, 6 + 3 P): pose in metres and degrees, planes in metres and radians; None where
    the truth has neither `pose_covariance` nor planes. Planes are given in the camera's frame, so
    an error of the pose is an error of the planes. The pose is therefore exact if the recording
    has planes and no covariance of the pose.
    """
    pose, planes = truth.pose_covariance, truth.plane_covariance
    if pose is None and planes is None:
        return None
    size = POSE + (0 if planes is None else len(planes))
    out = np.zeros((size, size))
    if pose is not None:
        units = np.array([1.0] * 3 + [np.degrees(1)] * 3)
        out[:POSE, :POSE] = pose * np.outer(units, units)
    if planes is not None:
        out[POSE:, POSE:] = planes
    return out


def spread_of(truth: Truth, usual: np.ndarray) -> np.ndarray:
    """
    Return the prior of a recording's own errors as standard deviations in independent directions.

    It is (6 + 3 P, 6 + 3 P) as from `factor`. `usual` is (6,) standard deviations of a pose whose
    covariance is not given, metres and degrees.
    """
    covariance = covariance_of(truth)
    return np.diag(usual) if covariance is None else factor(covariance)


def factor(covariance: np.ndarray) -> np.ndarray:
    """Return F with F F' = covariance, (n, n). Columns of directions without variance are zero."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0))
    size = np.where(size > 0, size, 1)
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    values = np.where(values > GROUND_TRUTH.fixed * values.max(initial=0), values, 0)
    return np.asarray(size[:, None] * vectors * np.sqrt(values))


def free_planes(covariance: np.ndarray | None) -> bool:
    """
    Return whether a recording has planes that were not measured, or not better than biases are.

    `covariance` is as from `covariance_of`. What counts is a plane's offset at given tilts: a
    plane that turns about the camera is as far away as before.
    """
    if covariance is None or len(covariance) == POSE:
        return False
    planes = covariance[POSE:, POSE:]
    offset = np.arange(len(planes)) % 3 == 0  # Two tilts follow each.
    across, tilts = planes[offset][:, ~offset], planes[~offset][:, ~offset]
    given = planes[offset][:, offset] - across @ np.linalg.pinv(tilts, hermitian=True) @ across.T
    return bool(np.diag(given).max() > REGISTRATION.smooth[0] ** 2)

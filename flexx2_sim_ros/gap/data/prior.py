"""What is known beforehand of a recording's own errors: its pose and its planes."""

from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.recording.truth import Truth
import numpy as np

POSE = 6


def covariance_of(truth: Truth, usual: np.ndarray) -> np.ndarray | None:
    """
    Return the covariance of a recording's own errors, if its ground truth says anything of it.

    Planes are given in the camera's frame, so that an error of the pose is an error of the planes:
    with planes and without a covariance of its own, the pose is taken for exact.

    Parameters
    ----------
    truth : Truth
        The recording's.
    usual : numpy.ndarray
        (6,) standard deviations of a pose, metres and degrees: of one whose covariance is not
        given.

    Returns
    -------
    numpy.ndarray or None
        (6 + 3 P, 6 + 3 P): pose in metres and degrees, planes in metres and radians. None where
        the truth has neither `pose_covariance` nor planes.

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


def factor(covariance: np.ndarray) -> np.ndarray:
    """Return F with F F' = covariance, (n, n); columns of fixed directions are zero."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0))
    size = np.where(size > 0, size, 1)
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    values = np.where(values > GROUND_TRUTH.fixed * values.max(initial=0), values, 0)
    return np.asarray(size[:, None] * vectors * np.sqrt(values))

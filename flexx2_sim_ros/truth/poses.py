"""Rigid poses of a camera in a room, and small motions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Pose:
    """A camera's pose in a room; its optical frame has x right, y down and z forward."""

    R: np.ndarray  # noqa: N815  (3, 3) rotation from the optical frame to the room's
    t: np.ndarray  # (3,) position in the room, metres

    def moved(self, twist: np.ndarray) -> 'Pose':
        """Return the pose after a (6,) motion: metres and a rotation vector, optical frame."""
        turn = Rotation.from_rotvec(twist[3:]).as_matrix()
        return Pose(self.R @ turn, self.t + self.R @ twist[:3])

    def motion_to(self, other: 'Pose') -> np.ndarray:
        """Return the (6,) motion from this pose to another; see `moved`."""
        turn = Rotation.from_matrix(self.R.T @ other.R).as_rotvec()
        return np.concatenate([self.R.T @ (other.t - self.t), turn])

    def numbers(self) -> list[float]:
        """Return x, y, z (metres) and the quaternion qx, qy, qz, qw."""
        return [*map(float, self.t), *map(float, Rotation.from_matrix(self.R).as_quat())]

    @classmethod
    def from_numbers(cls, numbers: Sequence[float] | np.ndarray) -> 'Pose':
        """Return the pose of x, y, z (metres) and a quaternion qx, qy, qz, qw (not 0)."""
        return cls(Rotation.from_quat(numbers[3:]).as_matrix(), np.array(numbers[:3], float))


def least_certain(covariance: np.ndarray) -> tuple[float, float]:
    """Return the largest deviations by a (6, 6) covariance of motions, metres and degrees."""
    metres, turn = (
        np.sqrt(np.linalg.eigvalsh(covariance[i : i + 3, i : i + 3])[-1]) for i in (0, 3)
    )
    return float(metres), float(np.degrees(turn))

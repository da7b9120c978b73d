"""
Rigid motions: poses, what small motions of a camera change, and poses fitted with a prior.

The optical frame has x right, y down and z forward. A small motion, (6,), is a step along these
axes, metres, and a turn about them. A point X of the scene is then at X - step - turn x X.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
import scipy  # scipy.spatial takes a third of a second and is loaded where it is needed.


@dataclass(frozen=True)
class Pose:
    """A camera's pose in a room."""

    R: np.ndarray  # noqa: N815  (3, 3) rotation from the optical frame to the room's
    t: np.ndarray  # (3,) position in the room, metres

    def moved(self, motion: np.ndarray) -> 'Pose':
        """Return the pose after a (6,) motion: metres and a rotation vector, optical frame."""
        return Pose(self.R @ rotation_of(motion[3:]), self.t + self.R @ motion[:3])

    def motion_to(self, other: 'Pose') -> np.ndarray:
        """Return the (6,) motion from this pose to another; see `moved`."""
        turn = scipy.spatial.transform.Rotation.from_matrix(self.R.T @ other.R).as_rotvec()
        return np.concatenate([self.R.T @ (other.t - self.t), turn])

    def numbers(self) -> list[float]:
        """Return x, y, z (metres) and the quaternion qx, qy, qz, qw."""
        turn = scipy.spatial.transform.Rotation.from_matrix(self.R)
        return [*map(float, self.t), *map(float, turn.as_quat())]

    @classmethod
    def from_numbers(cls, numbers: Sequence[float] | np.ndarray) -> 'Pose':
        """Return the pose of x, y, z (metres) and a quaternion qx, qy, qz, qw (not 0)."""
        turn = scipy.spatial.transform.Rotation.from_quat(numbers[3:])
        return cls(turn.as_matrix(), np.array(numbers[:3], float))


def rotation_of(turn: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation about an axis (3,) by its length, radians (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def least_certain(covariance: np.ndarray) -> tuple[float, float]:
    """Return the largest deviations by a (6, 6) covariance of motions, metres and degrees."""
    metres, turn = (
        np.sqrt(np.linalg.eigvalsh(covariance[i : i + 3, i : i + 3])[-1]) for i in (0, 3)
    )
    return float(metres), float(np.degrees(turn))


def ray_slopes(x: np.ndarray, y: np.ndarray, depth: np.ndarray, turn: float = 1.0) -> np.ndarray:
    """
    Return (2, 6, ...) how the rays to points change with a small motion of the camera.

    `x` and `y` are x/z and y/z of the rays, `depth` is z of the points, metres, (...) each; the
    motion is in metres and in turns of so many radians.
    """
    none, one = np.zeros_like(x), np.ones_like(x)
    across = [-one / depth, none, x / depth, turn * x * y, -turn * (one + x * x), turn * y]
    down = [none, -one / depth, y / depth, turn * (one + y * y), -turn * x * y, -turn * x]
    return np.stack([np.stack(across), np.stack(down)])


def depth_slopes(
    ray: np.ndarray, plane: np.ndarray, depth: np.ndarray, turn: float = 1.0
) -> np.ndarray:
    """
    Return (6, ...) how the depths along rays change with a small motion of the camera.

    `ray` is (3, ...) (x/z, y/z, 1); `plane` (3, ...) what it hits, n with n . X = 1; `depth` (...)
    metres. The motion is as for `ray_slopes`. Moved by t and turned by w, the camera sees the
    depth z - z n . t - z^2 w . (ray x n).
    """
    about = np.cross(ray, plane, axis=0) * turn
    return np.concatenate([-depth * plane, -(depth**2) * about])


def weighted_equations(
    slopes: np.ndarray, weight: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the (k, k) matrix and the (k,) right side of least squares, without a prior.

    `slopes` is (k, N) of the errors with each parameter, `weight` and `errors` are (N,).
    """
    root = np.sqrt(weight)
    rooted = slopes * root  # Times its own transpose, it is half the work.
    return rooted @ rooted.T, rooted @ (root * errors)


@dataclass
class SharedEquations:
    """
    Each recording's equations for the shared values alone, its nuisances eliminated.

    `normal`, (R, S, S), and `right`, (R, S), summed over recordings are the equations of the
    shared values. Of the nuisances' own block there are the `inverse`, (R, N, N), the block
    `mixed` with the shared values, (R, N, S), and the right side, (R, N).
    """

    normal: np.ndarray
    right: np.ndarray
    inverse: np.ndarray
    mixed: np.ndarray
    nuisance_right: np.ndarray

    def nuisance_step(self, step: np.ndarray) -> np.ndarray:
        """Return by how much the nuisances change, (R, N), with the shared values' step (S,)."""
        return np.asarray(
            (self.inverse @ (self.nuisance_right - self.mixed @ step)[..., None])[..., 0]
        )


def eliminate_nuisances(normal: np.ndarray, right: np.ndarray, shared: int) -> SharedEquations:
    """
    Eliminate each recording's nuisances, such as its pose, by the Schur complement.

    `normal` is (R, S + N, S + N), `right` (R, S + N), with the S `shared` values first. The matrix
    of all parameters is an arrow: nuisances of different recordings have nothing in common. So
    each recording is reduced alone, as in bundle adjustment: Triggs et al., Bundle adjustment - a
    modern synthesis, 2000, section 6.
    """
    inverse = np.linalg.inv(normal[:, shared:, shared:])
    across = normal[:, :shared, shared:] @ inverse
    mixed = normal[:, shared:, :shared]
    return SharedEquations(
        normal[:, :shared, :shared] - across @ mixed,
        right[:, :shared] - (across @ right[:, shared:, None])[..., 0],
        inverse,
        mixed,
        right[:, shared:],
    )

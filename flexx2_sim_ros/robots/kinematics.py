"""Forward and inverse kinematics of a robot's legs, in closed form."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Order in this package: legs front right, front left, rear right, rear left; joints hip, thigh,
# calf.


@dataclass(frozen=True)
class LegGeometry:
    """
    Four legs that abduct about x and have hip and knee about y, with the knees to the back.

    Attributes
    ----------
    hips : numpy.ndarray
        (4, 3) float64 metres: the abduction joints in the trunk's frame.
    offset : numpy.ndarray
        (4,) metres from the abduction axis to the leg's plane, positive to the left.
    thigh, calf : float
        Lengths, metres; the calf's up to the middle of the foot.
    lower, upper : numpy.ndarray
        (4, 3) joint limits of hip, thigh and calf, radians.
    foot_radius : float
        Metres.
    home : numpy.ndarray
        (3,) hip, thigh and calf of each leg at rest, radians.

    """

    hips: np.ndarray
    offset: np.ndarray
    thigh: float
    calf: float
    lower: np.ndarray
    upper: np.ndarray
    foot_radius: float
    home: np.ndarray

    @cached_property
    def neutral(self) -> np.ndarray:
        """Return (4, 2) metres: the point of the trunk's xy plane that a leg is attached to."""
        return self.hips[:, :2] + np.stack([np.zeros(4), self.offset], axis=1)

    @cached_property
    def standing_height(self) -> float:
        """Return the height of the trunk's middle above level ground, metres."""
        return float(self.foot_radius - feet(np.tile(self.home, (4, 1)), self)[:, 2].mean())


def feet(angles: np.ndarray, legs: LegGeometry) -> np.ndarray:
    """
    Return the feet's middles, (..., 4, 3) metres in the trunk's frame (x forward, y left, z up).

    ``angles`` are (..., 4, 3) radians: hip, thigh and calf of each leg.
    """
    hip, thigh, calf = np.moveaxis(np.asarray(angles, float), -1, 0)
    x = -legs.thigh * np.sin(thigh) - legs.calf * np.sin(thigh + calf)
    down = legs.thigh * np.cos(thigh) + legs.calf * np.cos(thigh + calf)
    y = legs.offset * np.cos(hip) + down * np.sin(hip)
    z = legs.offset * np.sin(hip) - down * np.cos(hip)
    return legs.hips + np.stack([x, y, z], axis=-1)


def joint_angles(points: np.ndarray, legs: LegGeometry) -> np.ndarray:
    """
    Return the joint angles, (..., 4, 3) radians, that put the feet at given points.

    Points are (..., 4, 3) metres in the trunk's frame, all below the abduction axes. For a point
    out of reach or beyond the joint limits, the leg points at it with angles within the limits.
    """
    x, y, z = np.moveaxis(np.asarray(points, float) - legs.hips, -1, 0)
    # In the leg's plane: `down` from the thigh's joint to the foot, along the hip's z axis.
    down = np.sqrt(np.maximum(y**2 + z**2 - legs.offset**2, 1e-12))
    hip = np.arctan2(z, y) - np.arctan2(-down, legs.offset)
    hip = np.arctan2(np.sin(hip), np.cos(hip))
    cosine = (x**2 + down**2 - legs.thigh**2 - legs.calf**2) / (2 * legs.thigh * legs.calf)
    calf = np.clip(-np.arccos(np.clip(cosine, -1.0, 1.0)), legs.lower[:, 2], legs.upper[:, 2])
    thigh = np.arctan2(-x, down) - np.arctan2(
        legs.calf * np.sin(calf), legs.thigh + legs.calf * np.cos(calf)
    )
    return np.stack(
        [
            np.clip(hip, legs.lower[:, 0], legs.upper[:, 0]),
            np.clip(thigh, legs.lower[:, 1], legs.upper[:, 1]),
            calf,
        ],
        axis=-1,
    )


def rotation(rpy: np.ndarray | tuple[float, float, float]) -> np.ndarray:
    """
    Return the rotation matrices (..., 3, 3) of roll, pitch and yaw (..., 3).

    In radians, about the fixed x, y and z axes in this order, as in ROS.
    """
    angles = np.moveaxis(np.asarray(rpy, float), -1, 0)
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

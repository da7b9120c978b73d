"""The trot of one robot or of many: its timing and limits, the height of feet, the trunk."""

from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.robots.footholds import REACH
from flexx2_sim_ros.robots.kinematics import LegGeometry
import numpy as np

# Diagonal legs swing together: FR with RL, FL with RR.
OFFSET = np.array([0.0, 0.5, 0.5, 0.0])


@dataclass(frozen=True)
class Gait:
    """
    Limits and timing of the trot.

    Attributes
    ----------
    max_speed : float
        In any direction, m/s.
    max_turn : float
        About the vertical, rad/s.
    period : float
        Of one cycle, seconds.
    duty : float
        The fraction of a cycle that a foot stands; above 0.5, so that at times all four stand.
    lift : float
        Clearance of a foot above what it passes, metres.
    acceleration, braking, turn_acceleration : float
        m/s^2, m/s^2 and rad/s^2.

    """

    max_speed: float = 0.8
    max_turn: float = 1.5
    period: float = 0.44
    duty: float = 0.56
    lift: float = 0.05
    acceleration: float = 2.0
    braking: float = 4.0
    turn_acceleration: float = 8.0


def apex_height(highest: Any, level: Any, gait: Gait) -> Any:
    """
    Return how high a foot goes, metres.

    ``highest`` is the height that it needs on its way, ``level`` the mean height of the feet;
    `gait` has its clearance.
    """
    # A leg can only fold so far: over the highest steps the clearance is smaller.
    return np.minimum(highest + gait.lift, np.maximum(level + REACH, highest + gait.lift / 2))


def trunk_pose(
    position: np.ndarray, yaw: float | np.ndarray, ground: np.ndarray, legs: LegGeometry
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the trunk's position, and roll, pitch and yaw, over the ground under the feet.

    They are (..., 3) metres and (..., 3) radians. ``position`` (..., 2) of the trunk in the world
    and ``ground`` (..., 4), the height under each foot, are in metres; ``yaw`` (...) is its
    heading, radians.
    """
    length = legs.hips[:2, 0].mean() - legs.hips[2:, 0].mean()
    width = np.abs(legs.neutral[:, 1]).mean() * 2
    front = ground[..., :2].mean(axis=-1) - ground[..., 2:].mean(axis=-1)
    left = ground[..., 1::2].mean(axis=-1) - ground[..., ::2].mean(axis=-1)
    # The trunk tilts less than the ground; the legs compensate for the rest.
    pitch = np.clip(-0.8 * np.arctan2(front, length), -0.4, 0.4)
    roll = np.clip(0.5 * np.arctan2(left, width), -0.25, 0.25)
    height = ground.mean(axis=-1) + legs.standing_height
    place = np.concatenate([position, height[..., None]], axis=-1)
    return place, np.stack([roll, pitch, np.broadcast_to(yaw, roll.shape)], axis=-1)

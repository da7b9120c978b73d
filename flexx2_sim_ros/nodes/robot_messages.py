"""
Messages of the robot node: received ones as arrays, and its own made from arrays.

The functions that take messages raise `InputError` for messages that cannot be used.
"""

from collections.abc import Mapping
import math

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.robots.parts import JointNames
from geometry_msgs.msg import Point, Pose, Twist, Vector3
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import JointState

# Tolerance of a quaternion's norm: some simulators send single precision.
_NORM_TOLERANCE = 0.01


def decode_twist(message: Twist, field: str) -> np.ndarray:
    """Return (3,) forward and left in m/s and the turn in rad/s, all finite."""
    values = {
        'linear.x': message.linear.x,
        'linear.y': message.linear.y,
        'angular.z': message.angular.z,
    }
    for name, value in values.items():
        if not math.isfinite(value):
            raise InputError(f'{field}: {name}: must be a finite number, got {value}')
    return np.array(list(values.values()))


def decode_pose(message: Odometry, field: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of an odometry: position (3,) metres, quaternion (4,) as w, x, y, z."""
    point, turn = message.pose.pose.position, message.pose.pose.orientation
    position = np.array([point.x, point.y, point.z])
    quaternion = np.array([turn.w, turn.x, turn.y, turn.z])
    if not np.isfinite(position).all():
        raise InputError(
            f'{field}: pose.pose.position: must be three finite numbers, got {position.tolist()}'
        )
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1.0) < _NORM_TOLERANCE:
        raise InputError(
            f'{field}: pose.pose.orientation: must be a quaternion of norm 1, got '
            f'{quaternion.tolist()} (w, x, y, z)'
        )
    return position, quaternion / norm


def decode_joints(message: JointState, field: str, joints: JointNames) -> dict[str, float]:
    """
    Return the joint positions of a message of any simulator, radians, by name.

    Names are the robot's; joints that it does not have keep those of the message. ``field`` is
    what errors call the message. Raises InputError when names and positions do not match, a joint
    comes twice, or a position is not finite.
    """
    if len(message.name) != len(message.position):
        raise InputError(
            f'{field}: position: must have one value for each of the {len(message.name)} '
            f'names, got {len(message.position)}'
        )
    found: dict[str, float] = {}
    given: dict[str, str] = {}
    for name, position in zip(message.name, message.position, strict=True):
        own = joints.find(name) or name
        if own in found:
            raise InputError(
                f'{field}: name: must have every joint once, got {shown(given[own])} and '
                f'{shown(name)}, which are the same joint'
            )
        if not math.isfinite(position):
            raise InputError(
                f'{field}: position of {shown(name)}: must be a finite number, got {position}'
            )
        found[own], given[own] = float(position), name
    return found


def joint_state(
    stamp: int, joints: Mapping[str, int], qpos: np.ndarray, velocity: np.ndarray
) -> JointState:
    """
    Return the robot's joints as a message; ``stamp`` is in nanoseconds.

    ``joints`` are addresses in the model's `qpos` by name, ``velocity`` is in their order.
    """
    addresses = list(joints.values())
    return JointState(
        header=messages.header(stamp, ''),
        name=list(joints),
        position=qpos[addresses].tolist(),
        velocity=velocity.tolist(),
    )


def odometry(
    stamp: int,
    frames: tuple[str, str],
    position: np.ndarray,
    quaternion: np.ndarray,
    linear: np.ndarray,
    angular: np.ndarray,
) -> Odometry:
    """
    Return the robot's true pose and velocity as a message; ``stamp`` is in nanoseconds.

    The first of ``frames`` has the position (3,) and the quaternion (4,) (w, x, y, z). The second
    is the robot's: the velocities, (3,), are in it, m/s and rad/s.
    """
    message = Odometry(header=messages.header(stamp, frames[0]), child_frame_id=frames[1])
    message.pose.pose = Pose(
        position=Point(**messages.xyz(position)), orientation=messages.quaternion(quaternion)
    )
    message.twist.twist = Twist(
        linear=Vector3(**messages.xyz(linear)), angular=Vector3(**messages.xyz(angular))
    )
    return message

"""What moves the robot: nothing, commanded velocities, or another simulator."""

from collections.abc import Callable
import math
from typing import Any, Protocol

from flexx2_sim_ros.errors import InputError, unquoted
from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
from flexx2_sim_ros.nodes.pacing import FrameGate
from flexx2_sim_ros.nodes.robot_messages import decode_joints, decode_pose, decode_twist
from flexx2_sim_ros.nodes.runtime import Throttle
from flexx2_sim_ros.rendering.rays import SceneGround
from flexx2_sim_ros.robots import gait
from flexx2_sim_ros.robots.kinematics import rotation
from flexx2_sim_ros.robots.model import stand
from flexx2_sim_ros.robots.parts import find_parts, JointNames
from flexx2_sim_ros.robots.robot import Robot
from flexx2_sim_ros.robots.trot import Gait
from geometry_msgs.msg import Twist
import mujoco
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

# A command is valid for this time, in simulated nanoseconds.
_COMMAND_HOLDS = 500_000_000
# A stamp earlier than any other, nanoseconds.
_BEFORE_ALL = -(2**63)
# The log names at most this many unknown joints.
_MOST_NAMES = 200


class RobotMotion(Protocol):
    """What moves the robot: it writes the pose into the model's state."""

    def reset(self) -> None:
        """Put the robot back to its start."""

    def advance(self, stamp: int, seconds: float) -> None:
        """Move for `seconds`, up to the time `stamp` (simulated nanoseconds)."""


class Standing:
    """The robot stands still."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> None:
        """Put the robot at its start."""
        self._model, self._data, self._robot = model, data, robot
        self.reset()

    def reset(self) -> None:
        """Stand where it started."""
        stand(self._model, self._data, self._robot)

    def advance(self, stamp: int, seconds: float) -> None:
        """Do nothing."""


class Walking:
    """
    The robot trots as ``cmd_vel`` commands; half a second after the last command it stands.

    ``how`` has limits and timing; it may be replaced while the robot walks. Raises InputError when
    the model does not have the robot's legs.
    """

    def __init__(
        self, node: Node, model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, how: Gait
    ) -> None:
        """Stand, and listen."""
        self._robot, self._parts = robot, find_parts(model, robot)
        if self._parts.legs is None or self._parts.free < 0:
            joints = robot.legs.all_names if robot.legs else ('none',)
            raise InputError(
                f"motion: 'cmd_vel' needs a robot that moves freely on the legs of {robot.name}, "
                f'with the joints {joints[0]} to {joints[-1]}. Choose another robot_model, or '
                'stand or external'
            )
        self.how = how
        self._node, self._model, self._data, self._legs = node, model, data, self._parts.legs
        self._addresses = self._parts.leg_addresses
        self._throttle = Throttle()
        self._now = 0
        self._ground = SceneGround(model, data, self._parts.geoms)
        self.reset()
        node.create_subscription(
            Twist,
            'cmd_vel',
            self._on_command,
            10,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def reset(self) -> None:
        """Stand where it started."""
        stand(self._model, self._data, self._robot)
        self._command, self._until = np.zeros(3), 0
        place = self._data.xpos[self._parts.trunk]
        axis = self._data.xmat[self._parts.trunk].reshape(3, 3)[:, 0]
        self._state = gait.start(
            place[:2], math.atan2(axis[1], axis[0]), float(place[2]), self._ground, self._legs
        )
        self._pose()

    def _on_command(self, message: Twist) -> None:
        try:
            self._command = decode_twist(message, 'cmd_vel')
        except InputError as error:
            if self._throttle.ready('command'):
                self._node.get_logger().error(f'{error}; the command is ignored')
            return
        self._until = self._now + _COMMAND_HOLDS

    def advance(self, stamp: int, seconds: float) -> None:
        """Walk for some time."""
        # A tick may be longer than a command is valid. After a clock went back, the validity of
        # the command is unknown.
        left = (self._until - stamp) * 1e-9 + seconds if stamp >= self._now else 0.0
        valid = min(max(left, 0.0), seconds)
        self._now = stamp
        if valid > 0:
            self._walk(self._command, valid)
        if valid < seconds:
            self._command = np.zeros(3)
            self._walk(self._command, seconds - valid)
        self._pose()

    def _walk(self, command: np.ndarray, seconds: float) -> None:
        self._state = gait.step(self._state, command, seconds, self._ground, self.how, self._legs)
        if self._state.blocked and self._throttle.ready('blocked'):
            self._node.get_logger().warning(
                'cmd_vel: an obstacle is in the way: the robot stands still'
            )

    def _pose(self) -> None:
        pose = gait.pose(self._state, self.how, self._legs)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation(pose.rpy).ravel())
        self._parts.place(self._data, pose.position, quaternion)
        self._data.qpos[self._addresses] = pose.angles
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)


class Mirroring:
    """
    The robot takes its pose from ``odom`` and ``joint_states`` of another simulator.

    A pose is shown when the joints of the same time are known: at the next joint message with its
    stamp or a later one, or at the next pose if no such message arrives before it. At most
    ``rate`` poses are shown per second. ``show`` is called with the stamp (nanoseconds) and the
    frame of the trunk (or an empty string) when the state is complete. Raises InputError when the
    robot cannot be moved freely.
    """

    def __init__(
        self,
        node: Node,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robot: Robot,
        rate: float,
        show: Callable[[int, str], None],
    ) -> None:
        """Stand, and listen."""
        self._parts = find_parts(model, robot)
        if self._parts.free < 0:
            raise InputError(
                "motion: 'external' needs a robot that moves freely, got no free "
                'joint above the trunk of robot_model'
            )
        self._node, self._model, self._data, self._show = node, model, data, show
        self._addresses = self._parts.joints
        self._names = JointNames(self._addresses)
        self._gate = FrameGate(rate)
        self._throttle = Throttle()
        self._named: set[str] = set()
        self._joints_stamp: int | None = None
        self._pose_stamp = 0
        self._waiting: tuple[int, str, np.ndarray, np.ndarray] | None = None
        stand(model, data, robot)
        overridable = QoSOverridingOptions.with_default_policies()
        for kind, topic, callback in (
            (JointState, 'joint_states', self._on_joints),
            (Odometry, 'odom', self._on_odometry),
        ):
            node.create_subscription(
                kind,
                topic,
                self._guarded(topic, callback),
                qos_profile_sensor_data,
                qos_overriding_options=overridable,
            )

    def reset(self) -> None:
        """Refuse: the other simulator sets the pose."""
        raise InputError('another simulator sets the pose (motion is external): reset it there')

    def advance(self, stamp: int, seconds: float) -> None:
        """Do nothing: the messages set the time."""

    def _guarded(self, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            try:
                callback(message)
            except InputError as error:
                if self._throttle.ready(topic):
                    self._node.get_logger().error(f'{error}; the message is ignored')

        return receive

    def _on_joints(self, message: JointState) -> None:
        joints = decode_joints(message, 'joint_states', self._names)
        self._name_once('does not have', sorted(joints.keys() - self._addresses.keys()))
        self._name_once(
            'has, and which no message named so far',
            sorted(self._addresses.keys() - joints.keys()),
        )
        for name, position in joints.items():
            if name in self._addresses:
                self._data.qpos[self._addresses[name]] = position
        self._joints_stamp = stamp_nanoseconds(message.header.stamp)
        if self._waiting is not None and self._joints_stamp >= self._waiting[0]:
            self._complete()

    def _on_odometry(self, message: Odometry) -> None:
        position, quaternion = decode_pose(message, 'odom')
        stamp = stamp_nanoseconds(message.header.stamp)
        restarts = self._gate.restarts
        due = self._gate.accept(stamp)
        if self._gate.restarts > restarts:
            self._forget_old_joints(stamp)
        self._pose_stamp = stamp
        if not due:
            return
        if self._waiting is not None:
            self._complete()
        self._waiting = stamp, message.child_frame_id, position, quaternion
        if self._joints_stamp is None or self._joints_stamp >= stamp:
            self._complete()

    def _forget_old_joints(self, stamp: int) -> None:
        # The simulation was reset to `stamp`. Joints with a stamp nearer to the last pose are from
        # before the reset. The new pose must wait for the next joints.
        joints = self._joints_stamp
        if joints is not None and abs(joints - self._pose_stamp) < abs(joints - stamp):
            self._joints_stamp = _BEFORE_ALL

    def _complete(self) -> None:
        assert self._waiting is not None
        stamp, frame, position, quaternion = self._waiting
        self._waiting = None
        self._parts.place(self._data, position, quaternion)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._show(stamp, frame)

    def _name_once(self, what: str, names: list[str]) -> None:
        new = [name for name in names if name not in self._named]
        if new and len(self._named) < _MOST_NAMES:
            self._named.update(new[:_MOST_NAMES])
            self._node.get_logger().warning(
                f'joint_states: joints that the robot {what}: {unquoted(", ".join(new), 400)}'
            )

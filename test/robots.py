"""A robot node in this process, and what drives it and listens to it, over real DDS."""

from contextlib import closing
import itertools
import math
import unittest

try:
    import rclpy  # noqa: F401
except ImportError as error:
    raise unittest.SkipTest('ROS 2 is not installed: rclpy cannot be imported') from error

from flexx2_sim_ros.nodes import robot_messages, tf_frames
from flexx2_sim_ros.nodes.robot_node import RobotCameras
from flexx2_sim_ros.robots.robot import load_robot
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from streams import CameraInfo, Clock, Image, NodeUser, Parameter

__all__ = [
    'CameraInfo',
    'Clock',
    'Image',
    'robot_messages',
    'tf_frames',
]  # the others are used here

# The scene with the least to draw, and rays: fast, and free of OpenGL.
USUAL = {'scene': 'corner', 'renderer': 'ray'}
_numbers = itertools.count()
_legs = load_robot().legs
JOINTS = _legs.all_names
RATE = 60  # hertz


def exact(stamps, rate=RATE):
    """Say whether stamps are those of ticks that follow each other."""
    first = round(stamps[0] * rate / 1e9)
    return stamps == [k * 10**9 // rate for k in range(first, first + len(stamps))]


class RobotUnderTest(NodeUser):
    """The node under test in a namespace of its own, and a user of its topics."""

    def __init__(self, *remappings, **values):
        """Start the node; values are of its parameters."""
        self.space = f'/robot_{next(_numbers)}'
        words = ['--ros-args', *(word for rule in remappings for word in ('-r', rule))]
        given = [Parameter(name, value=value) for name, value in {**USUAL, **values}.items()]
        super().__init__(
            f'{self.space}/go1_cameras',
            lambda: RobotCameras(namespace=self.space, cli_args=words, parameter_overrides=given),
        )
        self.robot = self._node

    def to(self, topic, kind):
        """Return a publisher that the node listens to."""
        publisher = self.node.create_publisher(kind, f'{self.space}/{topic}', 10)
        # Each side learns of the other at its own time; what comes before is lost.
        ends = [one for one in self.robot.subscriptions if one.topic_name == publisher.topic_name]
        self.spin_until(
            lambda: (
                publisher.get_subscription_count()
                and all(end.get_publisher_count() for end in ends)
            ),
            topic,
        )
        return publisher

    def hear(self, topic, kind):
        """Return the list that fills with what the node publishes."""
        name = topic if topic.startswith('/') else f'{self.space}/{topic}'
        heard = self.listen(name, kind)
        self.spin_until(
            lambda: all(
                publisher.get_subscription_count()
                for publisher in self.robot.publishers
                if publisher.topic_name == name
            ),
            topic,
        )
        return heard

    def more(self, heard, count):
        """Wait for some more messages; return them."""
        start = len(heard)
        self.spin_until(lambda: len(heard) >= start + count, f'{count} messages')
        return heard[start : start + count]

    def reset(self):
        """Call the reset service."""
        client = self.node.create_client(Trigger, f'{self.space}/go1_cameras/reset')
        self.spin_until(client.service_is_ready, 'reset service')
        return self.wait(client.call_async(Trigger.Request()))


def robot_node(*remappings, **values):
    """Return a `RobotUnderTest` that is closed at the end of the block."""
    return closing(RobotUnderTest(*remappings, **values))


def twist(x=0.0, y=0.0, turn=0.0):
    """Return a command."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = x, y, turn
    return message


def place(message):
    """Return an odometry's position and yaw."""
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    return np.array([at.x, at.y, at.z]), 2 * math.atan2(turn.z, turn.w)


def odometry(stamp, position, yaw=0.0, child='trunk'):
    """Return another simulator's pose."""
    message = Odometry(child_frame_id=child)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    at.x, at.y, at.z = map(float, position)
    turn.w, turn.z = math.cos(yaw / 2), math.sin(yaw / 2)
    return message


def joints(stamp, positions, names=JOINTS):
    """Return another simulator's joints."""
    message = JointState(name=list(names), position=list(map(float, positions)))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message

"""Frames of the robot and its cameras on ``/tf`` and ``/tf_static``, where tf2_msgs is there."""

from collections.abc import Iterable
from typing import Any

from flexx2_sim_ros.go1.model import CameraMount
from flexx2_sim_ros.nodes.go1_messages import transform
from geometry_msgs.msg import TransformStamped
import mujoco
import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

# Of an optical frame (x right, y down, z forward) in a camera's own (x forward, y left, z up).
_OPTICAL = np.array([0.5, -0.5, 0.5, -0.5])


def camera_transforms(base: str, mounts: Iterable[CameraMount]) -> list[TransformStamped]:
    """
    Return the frames of cameras: ``<camera>_link`` in the base, ``<camera>_optical_frame`` in it.

    Parameters
    ----------
    base : str
        The frame of the trunk.
    mounts : iterable of CameraMount
        The cameras.

    """
    result = []
    for mount in mounts:
        link = f'{mount.name}_link'
        quaternion = np.empty(4)
        # Columns of `mount.rotation` are the optical axes.
        right, down, forward = mount.rotation.T
        mujoco.mju_mat2Quat(quaternion, np.stack([forward, -right, -down], axis=1).ravel())
        result.append(transform(0, (base, link), np.array(mount.position), quaternion))
        result.append(transform(0, (link, f'{mount.name}_optical_frame'), np.zeros(3), _OPTICAL))
    return result


class FramePublisher:
    """
    Publish transforms; without tf2_msgs do nothing and say so once in the log.

    Parameters
    ----------
    node : rclpy.node.Node
        To publish with.

    """

    def __init__(self, node: Node) -> None:
        """Open the topics if there is a message type for them."""
        self._message: Any = None
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            node.get_logger().info('tf2_msgs is not installed: /tf and /tf_static stay empty')
            return
        self._message = TFMessage
        self._moving = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
        self._fixed = node.create_publisher(
            TFMessage, '/tf_static',
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def fixed(self, transforms: list[TransformStamped]) -> None:
        """Publish transforms that stay, all at once."""
        if self._message is not None:
            self._fixed.publish(self._message(transforms=transforms))

    def moving(self, message: TransformStamped) -> None:
        """Publish a transform of this moment."""
        if self._message is not None:
            self._moving.publish(self._message(transforms=[message]))

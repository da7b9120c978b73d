"""Frames of robots and cameras on ``/tf`` and ``/tf_static``, where tf2_msgs is installed."""

from collections.abc import Iterable, Sequence
from typing import Any, TYPE_CHECKING

from flexx2_sim_ros.nodes.messages import transform
from geometry_msgs.msg import TransformStamped
import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

if TYPE_CHECKING:  # a camera node needs no MuJoCo
    from flexx2_sim_ros.robots.robot import CameraMount

# Rotation (w, x, y, z) of the optical frame (x right, y down, z forward) in the camera's frame (x
# forward, y left, z up).
_OPTICAL = np.array([0.5, -0.5, 0.5, -0.5])
_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


def camera_transforms(
    base: str, mounts: Iterable['CameraMount'], prefix: str = ''
) -> list[TransformStamped]:
    """
    Return transforms of ``<camera>_link`` in the base and ``<camera>_optical_frame`` in the link.

    ``base`` is the frame of the trunk, ``prefix`` that of the cameras' frames.
    """
    result = []
    for mount in mounts:
        link = f'{prefix}{mount.name}_link'
        turn = _turned(mount.rpy, _UNTURNED)
        result.append(transform(0, (base, link), np.array(mount.position), turn))
        result.append(
            transform(0, (link, f'{prefix}{mount.name}_optical_frame'), np.zeros(3), _OPTICAL)
        )
    return result


def optical_transform(
    frames: tuple[str, str], position: Sequence[float], rpy: Sequence[float]
) -> TransformStamped:
    """
    Return a camera's optical frame in the frame that the camera is mounted on.

    ``frames`` are the parent and the optical frame. ``position`` of the lens in the parent is in
    metres; ``rpy`` is roll, pitch, yaw in radians, and zero looks along the parent's x axis,
    upright.
    """
    return transform(0, frames, np.array(position), _turned(rpy, _OPTICAL))


def _turned(rpy: Sequence[float], inner: np.ndarray) -> np.ndarray:
    # A rotation (w, x, y, z) in a frame that is turned about the fixed x, y and z axes.
    # Imported here: it takes a third of a second, and few cameras publish frames.
    from scipy.spatial.transform import Rotation

    both = Rotation.from_euler('xyz', rpy) * Rotation.from_quat(np.roll(inner, -1))
    return np.roll(both.as_quat(), 1)


class FramePublisher:
    """
    Publish transforms; without tf2_msgs, log that once and do nothing.

    ``moving`` says whether any frames move.
    """

    def __init__(self, node: Node, *, moving: bool = True) -> None:
        """Open the topics if tf2_msgs is installed."""
        self._message: Any = None
        self._moving: Any = None
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            node.get_logger().info('tf2_msgs is not installed: /tf and /tf_static stay empty')
            return
        self._message = TFMessage
        if moving:
            self._moving = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
        self._fixed = node.create_publisher(
            TFMessage,
            '/tf_static',
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )

    @property
    def wanted(self) -> bool:
        """Return whether the topic of moving frames has a subscription."""
        return self._moving is not None and self._moving.get_subscription_count() > 0

    def fixed(self, transforms: list[TransformStamped]) -> None:
        """Publish all fixed transforms; they replace those of the last call."""
        if self._message is not None:
            self._fixed.publish(self._message(transforms=transforms))

    def moving(self, transforms: list[TransformStamped]) -> None:
        """Publish moving transforms of one time."""
        if self._moving is not None:
            self._moving.publish(self._message(transforms=transforms))

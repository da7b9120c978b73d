"""The Go1 node: MuJoCo's view from the robot's front, as clean depth."""

from collections.abc import Sequence
import math
import time
from typing import Any

from flexx2_sim_ros.camera.modes import flexx2
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.go1.model import build_model, CameraMount, load_mounts, stand
from flexx2_sim_ros.go1.rendering import open_renderer, reflectivity_table
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.nodes.parameters import declare
import mujoco
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import CameraInfo, Image

_NANOSECONDS = 1_000_000_000


class Go1Cameras(Node):
    """
    A Unitree Go1 in MuJoCo with cameras on its front.

    Publishes for every camera ``<camera>/clean/depth_image``, ``<camera>/clean/camera_info`` and
    ``<camera>/clean/reflectivity``, all with the stamp of the state they show, and ``/clock``.
    """

    def __init__(self, **options: Any) -> None:
        """Build the model, open the renderer, then open the topics."""
        super().__init__('go1_cameras', **options)
        rate = self._declare('rate', 60.0, 'Frames a second of each camera, Hz.')
        if not (math.isfinite(rate) and 0 < rate <= 1000):
            raise InputError(f'rate: found {rate}, wanted a positive number of Hz, at most 1000')
        robot = self._declare('robot_model', 'builtin', 'builtin, or the path of an MJCF file.')
        scene = self._declare('scene', 'lab', 'lab, or the path of an MJCF file.')
        backend = self._declare('renderer', 'auto', 'auto, egl, osmesa or ray.')
        self._publish_clock = self._declare('publish_clock', True, 'Whether to publish /clock.')
        mounts = self._declare_mounts(load_mounts())
        self._intrinsics = flexx2().intrinsics
        self._model = build_model(robot, scene, intrinsics=self._intrinsics, mounts=mounts)
        self._data = mujoco.MjData(self._model)
        stand(self._model, self._data)
        self._reflectivity = reflectivity_table(self._model)
        self._renderer = open_renderer(self._model, self._intrinsics, backend)
        for reason in self._renderer.reasons:
            self.get_logger().warning(f'renderer passed over: {reason}')
        self._open_topics([mount.name for mount in mounts])
        self._rate_millihertz = round(rate * 1000)
        self._tick = 0
        self._rendered: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._started = time.monotonic()
        self.create_timer(1.0 / rate, self._step, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(
            f'{", ".join(mount.name for mount in mounts)} at {rate:g} Hz, rendered by '
            f'{self._renderer.backend}')

    def _declare(self, name: str, default: Any, description: str) -> Any:
        return declare(self, name, default, description, read_only=True)

    def _declare_mounts(self, defaults: Sequence[CameraMount]) -> list[CameraMount]:
        poses = {mount.name: mount for mount in defaults}
        names = self._declare('cameras', list(poses), 'Names of the cameras.')
        mounts = []
        for name in names:
            start = poses.get(name, CameraMount(name, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0)))
            position = self._declare(f'{name}.position', list(start.position),
                                     'Lens in the trunk frame (x forward, y left, z up), metres.')
            rpy = self._declare(f'{name}.rpy_deg', [math.degrees(a) for a in start.rpy],
                                'Roll, pitch (down), yaw (left) in degrees.')
            for field, values in (('position', position), ('rpy_deg', rpy)):
                if len(values) != 3:
                    raise InputError(f'{name}.{field}: found {list(values)}, wanted three numbers')
            x, y, z = map(float, position)
            roll, pitch, yaw = map(math.radians, rpy)
            mounts.append(CameraMount(name, (x, y, z), (roll, pitch, yaw)))
        return mounts

    def _open_topics(self, names: list[str]) -> None:
        overridable = QoSOverridingOptions.with_default_policies()
        kinds = {'depth_image': Image, 'camera_info': CameraInfo, 'reflectivity': Image}
        self._topics = {
            name: {topic: self.create_publisher(kind, f'{name}/clean/{topic}',
                                                QoSProfile(depth=10),
                                                qos_overriding_options=overridable)
                   for topic, kind in kinds.items()} for name in names}
        self._clock_topic = self.create_publisher(ClockMessage, '/clock', QoSProfile(depth=10))

    def _step(self) -> None:
        # The time of tick k is exactly k / rate: no drift, and no gap when rendering is late.
        self._tick += 1
        stamp = self._tick * 1000 * _NANOSECONDS // self._rate_millihertz
        self._data.time = stamp / _NANOSECONDS
        if self._publish_clock:
            self._clock_topic.publish(ClockMessage(clock=messages.time_message(stamp)))
        for name, topics in self._topics.items():
            self._publish(name, topics, stamp)
        self._watch_pace(stamp)

    def _publish(self, name: str, topics: dict[str, Any], stamp: int) -> None:
        head = messages.header(stamp, f'{name}_optical_frame')
        topics['camera_info'].publish(messages.camera_info_message(head, self._intrinsics))
        wanted = {topic: topics[topic].get_subscription_count() > 0
                  for topic in ('reflectivity', 'depth_image')}
        if not any(wanted.values()):
            return
        depth, reflectivity = self._render(name)
        if wanted['reflectivity']:
            topics['reflectivity'].publish(messages.image_message(head, reflectivity, '32FC1'))
        if wanted['depth_image']:
            topics['depth_image'].publish(messages.image_message(head, depth, '32FC1'))

    def _render(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        # What has not moved since it was rendered looks the same.
        last = self._rendered.get(name)
        if last is None or not np.array_equal(last[0], self._data.qpos):
            depth, geom_id = self._renderer.render(self._data, name)
            last = (self._data.qpos.copy(), depth.copy(), self._reflectivity[geom_id])
            self._rendered[name] = last
        return last[1], last[2]

    def _watch_pace(self, stamp: int) -> None:
        late = time.monotonic() - self._started - stamp / _NANOSECONDS
        if late > 1.0:
            pace = stamp / _NANOSECONDS / (stamp / _NANOSECONDS + late)
            self.get_logger().warning(
                f'rendering is slower than the rate: simulated time runs at {pace:.0%} of real '
                'time (lower the parameter rate)', once=True)

    def destroy_node(self) -> None:
        """Close the renderer, then the node."""
        renderer = getattr(self, '_renderer', None)
        if renderer is not None:
            renderer.close()
        super().destroy_node()

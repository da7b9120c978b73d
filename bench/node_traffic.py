"""The traffic of camera nodes that are measured: their input, and what comes back."""

import time

from bench.scenes import room
from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.profiles.modes import flexx2
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CameraInfo, Image


class Traffic:
    """
    Publishes the input of camera nodes and receives their depth images.

    * `cameras`: namespaces of the nodes
    * `rate`: images a second for each
    * `stamps`: stamps of the received images, nanoseconds
    * `latencies`: from publishing the input to receiving the image, seconds
    """

    def __init__(self, cameras, rate):
        """Create publishers and subscriptions."""
        self._cameras, self._rate = cameras, rate
        self.stamps = {name: [] for name in cameras}
        self.latencies = []
        self._sent = {}
        self._node = rclpy.create_node('bench')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._inputs = {}
        for name in cameras:
            self._inputs[name] = (
                self._node.create_publisher(CameraInfo, f'/{name}/clean/camera_info', 10),
                self._node.create_publisher(Image, f'/{name}/clean/depth_image', 10),
            )
            self._node.create_subscription(
                Image,
                f'/{name}/flexx2_camera/depth_image_0',
                lambda message, name=name: self._receive(name, message),
                10,
            )

    def _receive(self, name, message):
        stamp = stamp_nanoseconds(message.header.stamp)
        self.latencies.append(time.perf_counter() - self._sent[name, stamp])
        self.stamps[name].append(stamp)

    def _matched(self):
        return all(
            publisher.get_subscription_count()
            for pair in self._inputs.values()
            for publisher in pair
        ) and all(
            self._node.count_publishers(f'/{name}/flexx2_camera/depth_image_0')
            for name in self._cameras
        )

    def wait_for_nodes(self):
        """Wait until all publishers and subscriptions are matched, at most a minute."""
        deadline = time.monotonic() + 60
        while not self._matched() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.1)

    def feed(self, frames):
        """Publish this many images to each camera and receive theirs."""
        intrinsics, scene = flexx2().intrinsics, room()
        start = time.perf_counter()
        for tick in range(1, frames + 1):
            while (left := start + tick / self._rate - time.perf_counter()) > 0:
                self._executor.spin_once(timeout_sec=left)
            stamp = tick * 10**9 // self._rate
            for name, (info, image) in self._inputs.items():
                head = messages.header(stamp, 'camera')
                message = messages.image_message(head, scene, '32FC1')
                self._sent[name, stamp] = time.perf_counter()
                info.publish(messages.camera_info_message(head, intrinsics))
                image.publish(message)
        deadline = time.monotonic() + 2
        while len(self.latencies) < len(self._cameras) * frames and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)

"""The traffic of camera nodes that are measured: their input, and what comes back."""

import time

from bench.scenes import room
from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.profiles.modes import flexx2
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CameraInfo, Image

_START_SECONDS = 180.0  # on a busy machine
# A node may ask for another quality of service once it knows a publisher.
_SETTLE_SECONDS = 2.0


class Traffic:
    """
    Publishes the input of camera nodes and receives their depth images.

    * `cameras`: namespaces of the nodes
    * `rate`: images a second for each
    * `node`: the node that does both
    * `sent`: number of images that were published to each camera
    * `stamps`: stamps of the received images, nanoseconds
    * `latencies`: from publishing the input to receiving the image, seconds
    """

    def __init__(self, cameras, rate):
        """Create publishers and subscriptions."""
        self._cameras, self._rate = cameras, rate
        self.sent = 0
        self.stamps = {name: [] for name in cameras}
        self.latencies = []
        self._times = {}
        self.node = rclpy.create_node('bench')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._inputs = {}
        for name in cameras:
            self._inputs[name] = (
                self.node.create_publisher(CameraInfo, f'/{name}/clean/camera_info', 10),
                self.node.create_publisher(Image, f'/{name}/clean/depth_image', 10),
            )
            self.node.create_subscription(
                Image,
                f'/{name}/flexx2_camera/depth_image_0',
                lambda message, name=name: self._receive(name, message),
                10,
            )

    def _receive(self, name, message):
        stamp = stamp_nanoseconds(message.header.stamp)
        self.latencies.append(time.perf_counter() - self._times.pop((name, stamp)))
        self.stamps[name].append(stamp)

    def _matched(self):
        return all(
            publisher.get_subscription_count()
            for pair in self._inputs.values()
            for publisher in pair
        ) and all(
            self.node.count_publishers(f'/{name}/flexx2_camera/depth_image_0')
            for name in self._cameras
        )

    def spin_until(self, condition, seconds):
        """Handle messages until a condition is met, for so many seconds at most."""
        deadline = time.monotonic() + seconds
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.1)

    def wait_for_nodes(self):
        """Wait until all publishers and subscriptions are matched, at most three minutes."""
        self.spin_until(self._matched, _START_SECONDS)
        self.spin_until(lambda: False, _SETTLE_SECONDS)

    def feed(self, frames):
        """Publish this many images to each camera and receive theirs."""
        intrinsics, scene = flexx2().intrinsics, room()
        due = time.perf_counter()
        for _ in range(frames):
            while (left := due - time.perf_counter()) > 0:
                self._executor.spin_once(timeout_sec=left)
            # What is late is not made up for: bursts do not fit into the queues.
            due = max(due + 1 / self._rate, time.perf_counter())
            self.sent += 1
            stamp = self.sent * 10**9 // self._rate
            for name, (info, image) in self._inputs.items():
                head = messages.header(stamp, 'camera')
                message = messages.image_message(head, scene, '32FC1')
                self._times[name, stamp] = time.perf_counter()
                info.publish(messages.camera_info_message(head, intrinsics))
                image.publish(message)
        expected = len(self._cameras) * self.sent
        self.spin_until(lambda: len(self.latencies) >= expected, 2.0)

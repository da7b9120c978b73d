"""
Publish a recording as the real camera's driver does: ``python test/stand_in.py RECORDING.npz``.

The node has the driver's name, parameter `usecase` and topics. It waits until somebody subscribes,
publishes each frame once, and ends when nobody subscribes any more.
"""

from pathlib import Path
import sys

from flexx2_sim_ros.nodes.messages import camera_info_message, header, image_message
from flexx2_sim_ros.nodes.runtime import make_room_for_images
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording import load_recording
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

DRIVER = 'pmd_royale_ros_camera_node'
_FRAME_ID = f'{DRIVER}_optical_frame'
_SECONDS = 0.02  # between frames


class StandIn(Node):
    """
    A node that looks like the driver.

    `recording`: with gray images (uint8) as `amplitude`, one for each frame.
    """

    def __init__(self, recording):
        """Open the topics."""
        super().__init__(DRIVER)
        self.declare_parameter('usecase', recording.usecase or '')
        self.recording = recording
        height, width = recording.depth.shape[1:]
        self._lens = Intrinsics.from_matrix(recording.K, width, height)
        self._depth = self.create_publisher(Image, '~/depth_image_0', 10)
        self._gray = self.create_publisher(Image, '~/gray_image_0', 10)
        self._info = self.create_publisher(CameraInfo, '~/camera_info', 10)

    def publish(self, index):
        """Publish a frame with the stamp that it has in the recording."""
        head = header(int(self.recording.stamp_ns[index]), _FRAME_ID)
        depth = np.nan_to_num(self.recording.depth[index])
        self._info.publish(camera_info_message(head, self._lens))
        self._gray.publish(image_message(head, self.recording.amplitude[index], 'mono8'))
        self._depth.publish(image_message(head, depth, '32FC1'))

    def heard(self):
        """Return how many of the topics somebody subscribes to."""
        topics = self._depth, self._gray, self._info
        return sum(topic.get_subscription_count() > 0 for topic in topics)


def main(path):
    """Publish until nobody listens any more."""
    make_room_for_images()
    rclpy.init(args=[])
    node = StandIn(load_recording(path))
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin_while(condition):
        while condition():
            executor.spin_once(timeout_sec=_SECONDS)

    spin_while(lambda: node.heard() < 3)
    for index in range(len(node.recording.depth)):
        node.publish(index)
        executor.spin_once(timeout_sec=_SECONDS)
    spin_while(lambda: node.heard() > 0)
    rclpy.shutdown()


if __name__ == '__main__':
    main(Path(sys.argv[1]))

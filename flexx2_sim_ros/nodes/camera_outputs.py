"""The topics on which a camera node publishes its frames."""

from typing import Any

from flexx2_sim_ros.camera.frame import Frame, gray_image
from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.nodes.camera_parameters import CameraParameters
from flexx2_sim_ros.physics.geometry import pixel_rays, points
from flexx2_sim_ros.profiles.sensor import Sensor
import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header


class CameraOutputs:
    """
    Publish the frames of a camera under ``~/``, as the vendor's driver does.

    An image or a cloud is computed only if its topic has a subscription. ``settings`` are the
    node's parameters, as they are now; ``sensor`` gives the full scale of the grey image.
    """

    def __init__(self, node: Node, settings: CameraParameters, sensor: Sensor) -> None:
        """Open the topics."""
        self._node, self._settings = node, settings
        self._full_scale = sensor.full_scale_amplitude
        self._rays = pixel_rays(settings.intrinsics)
        # The lens does not change while the node runs: only the header is set for each frame.
        self._lens = messages.camera_info_message(Header(), settings.intrinsics)
        self._depth = self._publisher(Image, '~/depth_image_0')
        self._info = self._publisher(CameraInfo, '~/camera_info')
        self._cloud = self._publisher(PointCloud2, '~/point_cloud_0')
        self._gray = self._publisher(Image, '~/gray_image_0')
        self._noise = self._publisher(Image, '~/depth_noise_0')
        self._processed: Any = None
        if settings.chain is not None:
            self._processed = self._publisher(Image, '~/processed/depth_image')
            self._processed_info = self._publisher(CameraInfo, '~/processed/camera_info')
            small = settings.chain.lens(settings.intrinsics)
            self._processed_lens = messages.camera_info_message(Header(), small)

    def _publisher(self, kind: type, topic: str) -> Any:
        return self._node.create_publisher(
            kind,
            topic,
            # A new profile for each topic: rclpy writes the topic's override into it.
            QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    @property
    def wanted(self) -> bool:
        """Return whether any topic that needs a frame has a subscription."""
        images = self._depth, self._cloud, self._gray, self._noise, self._processed
        return any(map(_is_wanted, images))

    def publish_info(self, head: Header) -> None:
        """Publish the camera info of a frame."""
        self._lens.header = head
        self._info.publish(self._lens)

    def publish_frame(self, head: Header, frame: Frame) -> None:
        """Publish the images and the cloud that are wanted; changes invalid values in `frame`."""
        if _is_wanted(self._processed):
            self._publish_processed(head, frame.depth)
        if self._settings.invalid_is_zero:
            invalid = np.isnan(frame.depth)
            frame.depth[invalid] = 0.0
            frame.sigma[invalid] = 0.0
        if _is_wanted(self._depth):
            self._depth.publish(messages.image_message(head, frame.depth, '32FC1'))
        if _is_wanted(self._cloud):
            cloud = points(frame.depth, self._rays)
            swapped = self._settings.cloud_is_swapped
            self._cloud.publish(
                messages.cloud_message(head, cloud, frame.confidence, swapped=swapped)
            )
        if _is_wanted(self._gray):
            gray = gray_image(frame.amplitude, self._settings.exposure_share, self._full_scale)
            self._gray.publish(messages.image_message(head, gray, 'mono8'))
        if _is_wanted(self._noise):
            self._noise.publish(messages.image_message(head, frame.sigma, '32FC1'))

    def _publish_processed(self, head: Header, depth: np.ndarray) -> None:
        chain: Any = self._settings.chain
        image = chain.step(depth, stamp_nanoseconds(head.stamp))
        if image is None:
            return
        if self._settings.invalid_is_zero:
            image[np.isnan(image)] = 0.0
        self._processed.publish(messages.image_message(head, image, '32FC1'))
        self._processed_lens.header = head
        self._processed_info.publish(self._processed_lens)


def _is_wanted(publisher: Any) -> bool:
    return publisher is not None and bool(publisher.get_subscription_count() > 0)

"""Which topics a camera node reads clean images from, by the ROS graph."""

from contextlib import suppress
from dataclasses import replace

from flexx2_sim_ros.recording.bag_cameras import CameraTopics
from rclpy.node import Node, NodeNameNonExistentError


def remapped(node: Node, camera: CameraTopics) -> CameraTopics:
    """
    Return the topics of a camera with those of clean images that its node subscribes to.

    Simulators have names of their own for them. Of two images with such names, depth is the one
    that says so in its name.
    """
    space, _, name = camera.node.rpartition('/')
    found: dict[str, list[str]] = {'Image': [], 'CameraInfo': []}
    with suppress(NodeNameNonExistentError):
        for topic, kinds in node.get_subscriber_names_and_types_by_node(name, space or '/'):
            found.setdefault(kinds[0].rpartition('/')[2], []).append(topic)
    usual = replace(camera, inputs={})
    images = [topic for topic in found['Image'] if topic != usual.reflectivity]
    depths = images if len(images) == 1 else [topic for topic in images if 'depth' in topic]
    if len(depths) != 1:
        return usual
    inputs = {
        usual.clean: depths,
        usual.reflectivity: [topic for topic in images if topic not in depths],
        usual.clean_info: found['CameraInfo'],
    }
    return replace(
        usual,
        inputs={name: there[0] for name, there in inputs.items() if there and name not in there},
    )

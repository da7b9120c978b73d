"""What the ROS graph names: classes of message types, and where a camera reads clean images."""

from contextlib import suppress
from dataclasses import replace
import importlib
from importlib.machinery import PathFinder
from pathlib import Path
import re

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.recording.bag_cameras import CameraTopics
from rclpy.node import Node, NodeNameNonExistentError

# https://design.ros2.org/articles/legacy_interface_definition.html
_TYPE = re.compile(r'([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)', re.ASCII)


def message_class(kind: str) -> type:
    """
    Return the Python class of a message type such as ``sensor_msgs/msg/Image``.

    Importing a module runs it, and the name comes from outside, from a bag or the ROS graph. So
    only packages that rosidl generated are imported, and this is checked on their files. Raises
    InputError when it is no message type, or not installed.
    """
    match = _TYPE.fullmatch(kind)
    if match is None:
        raise InputError(
            f'type: must be a message type such as sensor_msgs/msg/Image, got {shown(kind)}'
        )
    package, name = match.groups()
    if not _is_generated(package):
        raise InputError(f'{kind[:80]}: this message type is not installed here')
    try:
        found = getattr(importlib.import_module(f'{package}.msg'), name, None)
    except ImportError as error:
        raise InputError(f'{kind[:80]}: this message type cannot be imported: {error}') from error
    if not (
        isinstance(found, type)
        and hasattr(found, '_TYPE_SUPPORT')
        and found.__module__.startswith(f'{package}.msg.')
    ):
        raise InputError(f'{kind[:80]}: this message type is not installed here')
    return found


def _is_generated(package: str) -> bool:
    # A generated package has the library with the type support of its messages beside it.
    spec = PathFinder.find_spec(package)
    folders = [] if spec is None else spec.submodule_search_locations or []
    return any(
        (Path(folder) / 'msg' / '__init__.py').is_file()
        and any(Path(folder).glob(f'{package}_s__rosidl_typesupport_c*'))
        for folder in folders
    )


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

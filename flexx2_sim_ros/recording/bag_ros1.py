"""Bags of ROS 1: their messages as ROS 2 has them."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording.bag_remains import Message
from flexx2_sim_ros.recording.chunks import naming
from rosbags.interfaces import ConnectionExtRosbag1
from rosbags.rosbag1 import Reader

# Types whose fields ROS 1 and ROS 2 serialize alike, except for the header's number.
_SAME_IN_ROS2 = frozenset(
    {
        messages.IMAGE,
        messages.COMPRESSED,
        messages.CAMERA_INFO,
        messages.POINT_CLOUD,
        'geometry_msgs/msg/PoseStamped',
        'geometry_msgs/msg/TransformStamped',
        'nav_msgs/msg/Odometry',
        'tf2_msgs/msg/TFMessage',
    }
)
# TF of bags up to ROS Hydro, the same by content.
_NOW = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}


def _kind(item: Any) -> str:
    return _NOW.get(item.msgtype, str(item.msgtype))


class Ros1Bag:
    """
    A ``.bag`` file of ROS 1; what a person should know is added to ``notes``.

    ``topics`` are types by topic, without those of types that are not read here. ``latched`` are
    topics whose publishers were latched. Raises InputError when it is no such file, is damaged, or
    was not closed.
    """

    def __init__(self, path: Path, notes: list[str]) -> None:
        """Open the bag, and close it again."""
        self._path = path
        self._notes = notes
        try:
            with Reader(path) as reader:
                connections = [
                    item
                    for item in reader.connections
                    if _kind(item) in _SAME_IN_ROS2 and item.msgcount
                ]
        except Exception as error:  # A damaged file breaks the reader in any way.
            raise InputError(
                f'{path}: must be a closed and indexed ROS 1 bag (rosbag reindex repairs one), '
                f'got {shown(str(error))}'
            ) from error
        self.topics = {item.topic: _kind(item) for item in connections}
        self.latched = {
            item.topic
            for item in connections
            if isinstance(item.ext, ConnectionExtRosbag1) and item.ext.latching
        }
        notes.append(f'{path}: has no checksums: damage inside of messages would not be noticed')

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Iterate over messages, by the time they were received, as ROS 2 serializes them."""
        store = messages.typestore()
        try:
            with naming(self._path), Reader(self._path) as reader:
                wanted = [
                    item
                    for item in reader.connections
                    if item.topic in topics and _kind(item) == self.topics.get(item.topic)
                ]
                if not wanted:
                    return
                for item, time, data in reader.messages(wanted):
                    content = bytes(store.ros1_to_cdr(data, _kind(item)))
                    yield Message(item.topic, _kind(item), time, content)
        except InputError:
            raise
        except Exception as error:  # A damaged file breaks the reader in any way.
            note = f'{self._path}: damaged: {shown(str(error))}; read up to there'
            if note not in self._notes:
                self._notes.append(note)

"""Record the topics of all cameras, including cameras that appear later."""

from array import array
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import partial
from pathlib import PurePosixPath
import time
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.ros_graph import message_class, remapped
from flexx2_sim_ros.nodes.subscriptions import LossCounter, matching
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording.bag_cameras import (
    EVENTS,
    find_cameras,
    INPUTS,
    Sample,
    sample,
    survey,
    unknown_topics,
)
from flexx2_sim_ros.recording.bag_remains import Message
from flexx2_sim_ros.recording.sink import BagSink, find_gaps, Gaps
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

_CLEAN = '/clean/depth_image'
_CLEAN_TOPICS = ('depth_image', 'camera_info', 'reflectivity')
# Holds one second at 60 Hz, for times in which this process does not run.
_DEPTH = 60
_LOOK_SECONDS = 0.5
# Topics that are needed to play cameras back. Without cameras they are not recorded.
_BESIDE = {EVENTS, '/tf', '/tf_static', '/clock'}


@dataclass
class TopicStatistics:
    """
    What was received on a topic.

    Attributes
    ----------
    kind : str
        Its type.
    messages, size : int
        Number of recorded messages and bytes.
    first : float
        Arrival of the first message, seconds after the first message of any topic.
    refused : int
        Messages lost because the queue was full.
    numbers : LossCounter
        Messages lost in transit, by the publisher's sequence numbers.
    stamps : array of int
        Stamps of all messages that arrived, nanoseconds; empty for types without a stamp.

    """

    kind: str
    messages: int = 0
    size: int = 0
    first: float = 0.0
    refused: int = 0
    numbers: LossCounter = field(default_factory=LossCounter)
    stamps: 'array[int]' = field(default_factory=lambda: array('q'))

    @property
    def lost(self) -> int:
        """Return the number of lost messages."""
        return self.refused + self.numbers.lost

    @property
    def rate_hz(self) -> float:
        """Return the rate by stamps; 0 with fewer than two."""
        if len(self.stamps) < 2 or self.stamps[-1] <= self.stamps[0]:
            return 0.0
        return (len(self.stamps) - 1) * 1e9 / (self.stamps[-1] - self.stamps[0])

    def gaps(self) -> Gaps:
        """Return the gaps in the stamps."""
        return find_gaps(self.stamps)


class Recorder(Node):
    """
    Subscribe to all cameras, including those that appear later, and pass messages to a sink.

    Messages are not decoded. A subscription is reliable if the publisher is. ``cameras`` are the
    only ones to record, by name (namespace) or node; all when empty. ``also`` are other topics to
    record, with wildcards: ``*/point_cloud_0``.

    Attributes
    ----------
    topics : dict of str to TopicStatistics
        By topic.
    started : float or None
        When the first message came, by the monotonic clock.
    taken : int
        Number of messages received.

    """

    def __init__(self, sink: BagSink, cameras: Sequence[str], also: Sequence[str]) -> None:
        """Look for topics now and every half second."""
        super().__init__('flexx2_record', start_parameter_services=False)
        self.topics: dict[str, TopicStatistics] = {}
        self.started: float | None = None
        self.taken = 0
        self._sink = sink
        self._cameras = {name.strip('/') for name in cameras}
        self._also = also
        self._time = 0
        self._questions: dict[str, Any] = {}
        self._asked: set[str] = set()
        self._samples: dict[str, Sample] = {}
        self._probes: dict[str, Any] = {}
        self._said: set[str] = set()
        self._names: dict[str, list[str]] = {}
        self._subscribe(EVENTS, messages.PARAMETER_EVENT)
        self._look()
        self.create_timer(_LOOK_SECONDS, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def seconds(self) -> float:
        """Return the time since the first message."""
        return 0.0 if self.started is None else time.monotonic() - self.started

    def _look(self) -> None:
        there = {
            topic: kinds[0] for topic, kinds in self.get_topic_names_and_types() if len(kinds) == 1
        }
        wanted = [
            topic
            for topic in there
            if topic in _BESIDE or any(fnmatchcase(topic, name) for name in self._also)
        ]
        own = [remapped(self, camera) for camera in find_cameras(there).values()]
        # In the bag, clean images have the names by which they are found there. Two cameras may
        # have the same ones.
        for camera in own:
            for clean in _CLEAN_TOPICS:
                usual = f'{camera.space}/clean/{clean}'
                names = self._names.setdefault(camera.inputs.get(usual, usual), [])
                if usual not in names:
                    names.append(usual)
            if self._is_wanted(camera.name, camera.node):
                wanted += camera.inputs.values()
        others = {topic: kind for topic, kind in there.items() if self._names_of(topic) == [topic]}
        for topic in unknown_topics(others):
            self._probe(topic, there[topic])
        found = survey(others, self._samples)
        for camera in found.cameras.values():
            node = camera.node or self._publisher(camera.depth)
            # A camera of an unknown node is named by its depth topic: match any namespace.
            spaces = [] if camera.node else list(map(str, PurePosixPath(camera.name).parents))
            if self._is_wanted(camera.name, node, *spaces):
                wanted += [camera.depth, camera.info, camera.gray]
                self._ask(node)
        self._say_unclear(found.unclear)
        for topic in there:
            space = topic.removesuffix(_CLEAN)
            if space != topic and self._is_wanted(space):
                wanted += [f'{space}/clean/{name}' for name in _CLEAN_TOPICS]
        for topic in wanted:
            if topic in there and topic not in self.topics:
                self._subscribe(topic, there[topic])

    def _probe(self, topic: str, kind: str) -> None:
        # One message shows whether a topic with an unknown name belongs to a camera.
        if topic in self._samples or topic in self._probes:
            return
        offers = self._offers(topic)
        if not offers:
            return
        # A camera info may have been sent once, before this node was there.
        reliability, durability = matching(offers)
        self._probes[topic] = self.create_subscription(
            message_class(kind),
            topic,
            partial(self._on_probe, topic, kind),
            QoSProfile(depth=5, reliability=reliability, durability=durability),
            raw=True,
        )

    def _on_probe(self, topic: str, kind: str, data: bytes) -> None:
        if topic in self._samples:
            return
        with suppress(InputError):
            self._samples[topic] = sample(kind, data, topic)
            self.destroy_subscription(self._probes[topic])

    def _offers(self, topic: str) -> list[QoSProfile]:
        # What the publishers offer; empty while other nodes only subscribe.
        return [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]

    def _publisher(self, topic: str) -> str:
        # The full name of the one node that publishes a topic, else an empty text.
        nodes = {
            f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for info in self.get_publishers_info_by_topic(topic)
        }
        return nodes.pop() if len(nodes) == 1 else ''

    def _say_unclear(self, unclear: list[list[str]]) -> None:
        for topics in unclear:
            if not self._said & set(topics):
                self._said |= set(topics)
                self.get_logger().warning(
                    f'{", ".join(topics)}: not recorded: they have the same camera info, so it is '
                    'not clear which one is the depth of the camera; --also TOPIC records one'
                )

    def _is_wanted(self, *names: str) -> bool:
        return not self._cameras or bool(self._cameras & {name.strip('/') for name in names})

    def _subscribe(self, topic: str, kind: str) -> None:
        offers = self._offers(topic)
        if topic != EVENTS and not offers:
            return
        self.topics[topic] = TopicStatistics(kind)
        reliability, durability = matching(offers)
        quality = QoSProfile(depth=_DEPTH, reliability=reliability, durability=durability)
        try:
            message_type = message_class(kind)
        except InputError as error:
            self.get_logger().warning(f'{topic}: not recorded: {error}')
            return
        if kind not in messages.typestore().fielddefs:
            self.get_logger().warning(f'{topic}: not recorded: {kind} is not in ROS 2 Jazzy')
            return
        if reliability == ReliabilityPolicy.BEST_EFFORT:
            self.get_logger().warning(
                f'{topic}: is published as best effort: messages can be lost'
            )
        for name in self._names_of(topic) if offers else ():
            self._sink.offer(name, [_offered(offer) for offer in offers])
        self.create_subscription(
            message_type, topic, partial(self._on_message, topic), quality, raw=True
        )

    def _on_message(self, topic: str, data: bytes, info: dict[str, Any]) -> None:
        self.taken += 1
        statistics = self.topics[topic]
        statistics.numbers.count(
            info['publication_sequence_number'],
            lambda: topic != EVENTS and self.count_publishers(topic) <= 1,
        )
        if self.started is None and (
            topic not in _BESIDE or any(fnmatchcase(topic, name) for name in self._also)
        ):
            self.started = time.monotonic()
        if not statistics.messages + statistics.refused:
            statistics.first = self.seconds
        if statistics.kind in messages.STAMPED:
            with suppress(InputError):  # Messages of every type are recorded.
                statistics.stamps.append(messages.header_stamp(data, topic))
        self._put(topic, data)

    def _put(self, topic: str, data: bytes) -> None:
        statistics = self.topics[topic]
        # A bag is read in order of time. If the clock is set back, times must still not go back.
        self._time = max(self._time, time.time_ns())
        if all(
            self._sink.put(Message(name, statistics.kind, self._time, data))
            for name in self._names_of(topic)
        ):
            statistics.messages += 1
            statistics.size += len(data)
        else:
            statistics.refused += 1

    def _names_of(self, topic: str) -> list[str]:
        return self._names.get(topic, [topic])

    def _ask(self, node: str) -> None:
        # No message gives the present mode, nor whether clean depth is along the ray: ask for them
        # once and record them as messages.
        if not node:
            return
        client = self._questions.get(node)
        if client is None:
            client = self.create_client(GetParameters, f'{node}/get_parameters')
            self._questions[node] = client
        if node not in self._asked and client.service_is_ready():
            self._asked.add(node)
            # One request each: the real driver has none of INPUTS, and would return no values.
            for name in ('usecase', *INPUTS):
                future = client.call_async(GetParameters.Request(names=[name]))
                future.add_done_callback(partial(self._on_parameter, node, name))

    def _on_parameter(self, node: str, name: str, future: Any) -> None:
        response = future.result()
        if response is None or not response.values or not response.values[0].string_value:
            return
        text, now = response.values[0].string_value, self.get_clock().now().nanoseconds
        self._put(EVENTS, messages.encode_text_parameter(now, node, name, text))


def _offered(profile: QoSProfile) -> Qos:
    # rosbags and rclpy both number the policies as rmw does.
    return Qos(
        QosHistory(profile.history),
        profile.depth,
        QosReliability(profile.reliability),
        QosDurability(profile.durability),
        _period(profile.deadline),
        _period(profile.lifespan),
        QosLiveliness(profile.liveliness),
        _period(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def _period(duration: Duration) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))

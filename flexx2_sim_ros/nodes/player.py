"""Play a bag: publish its messages at the times of their stamps."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
import math
import time
from typing import Any

from flexx2_sim_ros.errors import InputError, printable
from flexx2_sim_ros.nodes.messages import time_message
from flexx2_sim_ros.nodes.ros_graph import message_class
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording.bag_cameras import CARRIED, EVENTS
from flexx2_sim_ros.recording.bag_files import Bag
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

_CLOCK = '/clock'
# Not played: the clock is published by this node, and the others are about absent nodes.
_LEFT_OUT = {_CLOCK, EVENTS, '/rosout'}
# Latched by definition, even if the bag gives another QoS.
_LATCHED = {'/tf_static'}
_TIMED = {messages.IMAGE, messages.POINT_CLOUD}
_RESET_NANOSECONDS = 1_000_000_000
_LEAP_NANOSECONDS = 10_000_000_000
_NAP_SECONDS = 0.05
# How far a subscriber may lag: a hundred messages, or a megabyte of large ones. Then the player
# waits for it; for a subscriber that does not respond it waits only once. Fast DDS acknowledges
# fragmented messages at once, and others only every three seconds.
_DEPTH = 100
_AHEAD_BYTES = 1_000_000
_FRAGMENTED_BYTES = 65_536
_PATIENCE_SECONDS = 1.0
_UNDER_WAY_SECONDS = 0.5


class Player(Node):
    """
    Publish the messages of a bag, and with `clock` also ``/clock``.

    ``patterns`` are the topics, with wildcards; all when empty. ``sent`` counts the messages
    published, ``late`` is the largest delay of one, seconds. Raises InputError when no topic
    remains to play.
    """

    def __init__(self, bag: Bag, patterns: Sequence[str], clock: bool) -> None:
        """Open the topics."""
        super().__init__('flexx2_replay', start_parameter_services=False)
        self.sent = 0
        self.late = 0.0
        self._bag = bag
        self._publishers_by_topic: dict[str, Any] = {}
        self._ahead: defaultdict[str, float] = defaultdict(float)
        for topic, kind in bag.topics.items():
            if (
                topic in _LEFT_OUT
                or (topic.endswith(CARRIED) and kind == messages.BYTES)
                or (patterns and not any(fnmatchcase(topic, pattern) for pattern in patterns))
            ):
                continue
            try:
                latched = topic in _LATCHED or topic in bag.latched
                self._publishers_by_topic[topic] = self.create_publisher(
                    message_class(kind),
                    topic,
                    QoSProfile(
                        depth=_DEPTH,
                        durability=(
                            DurabilityPolicy.TRANSIENT_LOCAL
                            if latched
                            else DurabilityPolicy.VOLATILE
                        ),
                    ),
                )
            except (InputError, InvalidTopicNameException, ValueError) as error:
                self.get_logger().warning(printable(f'{topic}: left out: {error}'))
        if not self._publishers_by_topic:
            raise InputError(
                f'{bag.path}: topics: must match some of {", ".join(bag.topics)}, got none'
            )
        kinds = {bag.topics[topic] for topic in self._publishers_by_topic}
        # A camera info that was sent once often has the stamp 0. Without stamps of a camera, the
        # times at which messages were received are used.
        self._timed = kinds & _TIMED or kinds & {messages.CAMERA_INFO}
        self._clock_topic = (
            self.create_publisher(Clock, _CLOCK, QoSProfile(depth=_DEPTH)) if clock else None
        )
        self._now: int | None = None
        self._received = 0
        self._origin = 0
        self._started = 0.0

    def unheard(self) -> list[str]:
        """Return the topics without a subscription."""
        return [
            topic
            for topic, publisher in self._publishers_by_topic.items()
            if not publisher.get_subscription_count()
        ]

    def play(self, rate: float, stop: Callable[[], bool]) -> None:
        """
        Play the bag once, at `rate` seconds of the bag per second of real time.

        ``stop`` is called often; playing ends when it returns true.
        """
        self._now = None
        for topic, kind, received, data in self._bag.messages(self._publishers_by_topic):
            if kind in self._timed:
                with suppress(InputError):  # Messages of every type are sent.
                    self._wait(messages.header_stamp(data, topic), received, rate, stop)
            elif not self._timed:
                self._wait(received, received, rate, stop)
            if stop():
                return
            self._publish(topic, data)

    def _publish(self, topic: str, data: bytes) -> None:
        publisher = self._publishers_by_topic[topic]
        publisher.publish(data)
        self.sent += 1
        if len(data) > _FRAGMENTED_BYTES:
            self._ahead[topic] += len(data)
        if self._ahead[topic] > _AHEAD_BYTES:
            self._ahead[topic] = 0
            if not publisher.wait_for_all_acked(Duration(seconds=_PATIENCE_SECONDS)):
                self._ahead[topic] = -math.inf
                self.get_logger().warning(
                    f'{topic}: a subscriber no longer acknowledges messages: replay goes on '
                    'without it'
                )

    def finish(self, seconds: float) -> bool:
        """Wait until subscribers have all messages; return whether they have them in time."""
        # Best-effort topics acknowledge nothing and lose what is in transit when they close.
        time.sleep(min(_UNDER_WAY_SECONDS, seconds))
        deadline = time.monotonic() + seconds
        return all(
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))
            for publisher in self._publishers_by_topic.values()
        )

    def _wait(self, stamp: int, received: int, rate: float, stop: Callable[[], bool]) -> None:
        # Time advances with the first message of a new stamp. A message of another topic with a
        # slightly older stamp is sent at once. A stamp that goes far back is a reset simulation;
        # one that leaps ahead is of another clock, such as after a stamp of 0.
        if self._now is not None and self._now - _RESET_NANOSECONDS < stamp <= self._now:
            return
        waited = received - self._received
        if (
            self._now is None
            or stamp < self._now
            or stamp - self._now > max(waited, 0) + _LEAP_NANOSECONDS
        ):
            self._origin, self._started = stamp, time.monotonic()
        self._now, self._received = stamp, received
        due = self._started + (stamp - self._origin) / 1e9 / rate
        while (left := due - time.monotonic()) > 0 and not stop():
            time.sleep(min(left, _NAP_SECONDS))
        self.late = max(self.late, time.monotonic() - due)
        if self._clock_topic is not None:
            self._clock_topic.publish(Clock(clock=time_message(stamp)))

"""Simulated time: published by one node, followed by the others."""

from collections.abc import Callable
import time
from typing import Any

from flexx2_sim_ros.errors import shown
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.nodes.steady_node import take
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

_TOPIC = '/clock'
_SILENT_SECONDS = 3.0


class SimClock:
    """
    Publish ``/clock``, or follow it if another node of this machine already publishes it.

    ``use_sim_time`` of the node makes it follow; unless it follows, ``publish`` says whether to
    publish. ``on_time`` is called with each time of the followed clock, nanoseconds. ``follows``
    says whether time comes from another node.
    """

    def __init__(self, node: Node, publish: bool, on_time: Callable[[int], None]) -> None:
        """Become the publisher of the clock, or follow it."""
        self._node = node
        # After remapping: robots with a clock of their own each do not share a claim.
        self._topic = node.resolve_topic_name(_TOPIC)
        self._on_time = on_time
        self._publisher: Any = None
        self._claim: Any = None
        self._last = time.monotonic()
        self._warned = False
        self.follows = bool(node.get_parameter('use_sim_time').value)
        if publish and not self.follows:
            try:
                self._claim = take(node, self._topic)
            except OSError:
                self.follows = True
                node.get_logger().warning(
                    f'{self._topic}: another robot publishes it already; this one follows it '
                    '(use_sim_time:=true avoids this warning; publish_clock:=false keeps '
                    'a time of its own)'
                )
        if self.follows:
            node.create_subscription(
                Clock,
                _TOPIC,
                self._on_clock,
                QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
            )
        elif publish:
            self._publisher = node.create_publisher(Clock, _TOPIC, QoSProfile(depth=10))

    def publish(self, stamp: int) -> None:
        """Publish a time in nanoseconds, unless this node follows."""
        if self._publisher is not None:
            self._publisher.publish(Clock(clock=messages.time_message(stamp)))

    def watch(self) -> None:
        """Warn once when followed time stands still, or when there are two clocks."""
        silent = self.follows and time.monotonic() - self._last > _SILENT_SECONDS
        others = []
        if self._publisher is not None:
            mine = self._node.get_name(), self._node.get_namespace()
            others = [
                info
                for info in self._node.get_publishers_info_by_topic(self._topic)
                if (info.node_name, info.node_namespace) != mine
            ]
        if not self._warned and silent:
            self._node.get_logger().warning(
                f'{self._topic}: no message for {_SILENT_SECONDS:g} s: simulated time stands still'
            )
        if not self._warned and others:
            name = f'{others[0].node_namespace.rstrip("/")}/{others[0].node_name}'
            self._node.get_logger().error(
                f'{self._topic}: {shown(name)} publishes it too, and time will jump: start this '
                'node with use_sim_time:=true (it then follows) or publish_clock:=false'
            )
        self._warned = bool(silent or others)

    def close(self) -> None:
        """Allow another node to publish the clock."""
        if self._claim is not None:
            self._claim.close()

    def _on_clock(self, message: Clock) -> None:
        self._last = time.monotonic()
        self._on_time(message.clock.sec * 1_000_000_000 + message.clock.nanosec)

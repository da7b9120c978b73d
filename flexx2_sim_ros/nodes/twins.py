"""What one node only may be: the owner of its name, and the source of simulated time."""

from collections.abc import Callable
import socket
import sys
import time
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.nodes import messages
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock


def twin_text(node: Node) -> str:
    """Return the error for a second node of the same name."""
    return (
        f'node name: must be unique, got {node.get_fully_qualified_name()}, which is running '
        'already. Choose another name or namespace, e.g. --ros-args -r __node:=another'
    )


def take(node: Node, name: str) -> socket.socket | None:
    """
    Claim a name in the node's ROS domain for this process.

    The claim is an abstract socket name, which Linux releases when the process ends, even after a
    crash. On other systems nothing is claimed.

    Returns
    -------
    socket.socket or None
        Must be kept; closing it releases the name.

    Raises
    ------
    OSError
        When the name is claimed.

    """
    if sys.platform != 'linux':
        return None
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    whole = f'ros/{node.context.get_domain_id()}{name}'
    try:
        # At most 108 bytes: names differ at their end.
        claim.bind('\0' + whole[-100:])
    except OSError:
        claim.close()
        raise
    return claim


def claim_name(node: Node) -> socket.socket | None:
    """
    Claim a node's name on this machine: in the graph, a second node appears only after 3 s.

    Returns
    -------
    socket.socket or None
        Must be kept while the node runs.

    Raises
    ------
    InputError
        When another process has claimed it.

    """
    try:
        return take(node, node.get_fully_qualified_name())
    except OSError as error:
        raise InputError(twin_text(node)) from error


_TOPIC = '/clock'
_SILENT_SECONDS = 3.0


class SimClock:
    """
    Publish ``/clock``, or follow it if another node of this machine already publishes it.

    Parameters
    ----------
    node : rclpy.node.Node
        The node; its parameter ``use_sim_time`` makes it follow.
    publish : bool
        Whether to publish unless it follows.
    on_time : callable
        Called with each time of the followed clock, nanoseconds.

    Attributes
    ----------
    follows : bool
        Whether time comes from another node.

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

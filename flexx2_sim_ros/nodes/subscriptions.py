"""Subscriptions that adapt to the QoS of publishers and count lost messages."""

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

# The depth of most publishers. A lost reliable message is sent again as long as both sides have
# room for the messages after it.
_DEPTH = 10
_OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)


def matching(offers: Sequence[QoSProfile]) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    """
    Return the strongest reliability and durability that match every publisher's offer.

    Reliable unless a publisher is not; transient local only if all publishers are.
    """
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = bool(offers) and all(
        offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers
    )
    return (
        ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class LossCounter:
    """Count lost messages, those missing between the ones that arrived, by sequence numbers."""

    def __init__(self) -> None:
        """Start without lost messages."""
        self.lost = 0
        self._last: int | None = None

    def count(self, number: int | None, alone: Callable[[], bool]) -> None:
        """
        Add the sequence number of a message; None if the middleware has none.

        ``alone`` returns whether the topic has one publisher; numbers of several are not
        comparable.
        """
        if number is not None and self._last is not None and number > self._last + 1 and alone():
            self.lost += number - self._last - 1
        self._last = number


class Input:
    """
    A subscription that follows the QoS of its topic's publishers.

    A reliable subscription receives nothing from a best-effort publisher. A best-effort one loses
    messages larger than the publisher's shared memory. A volatile one misses latched messages.
    So the subscription requests the strongest QoS that all publishers offer, and it is created
    again when that changes. ROS parameters (``qos_overrides.<topic>.subscription.*``) override
    this; their default is ``best_available``. The argument ``topic`` is the name before remapping,
    the attribute that after it.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[[Any], None]
    ) -> None:
        """Subscribe."""
        self.topic = node.resolve_topic_name(topic)
        self._node, self._kind, self._name, self._callback = node, kind, topic, callback
        self._lost_before = self._reported = 0
        self._numbers = LossCounter()
        self._subscription = self._subscribe()

    @property
    def lost(self) -> int:
        """Return the number of lost messages, if the middleware reports it."""
        return self._lost_before + max(self._reported, self._numbers.lost)

    @property
    def publishers(self) -> int:
        """Return how many publishers the topic has."""
        return self._node.count_publishers(self.topic)

    def follow(self) -> None:
        """Subscribe again if the publishers now offer another QoS than is requested."""
        current = self._subscription.qos_profile
        # Without publishers, keep the QoS: the same publisher may come back.
        if not self.publishers or self._best() == (current.reliability, current.durability):
            return
        self._lost_before = self.lost
        self._reported, self._numbers = 0, LossCounter()
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._subscribe()

    def _subscribe(self) -> Subscription:
        def resolve(profile: QoSProfile) -> SetParametersResult:
            # Called with the parameters written into the profile, before it is used.
            self._asked = (profile.reliability, profile.durability)
            profile.reliability, profile.durability = self._best()
            return SetParametersResult(successful=True)

        def subscribe(**more: Any) -> Subscription:
            wish = QoSProfile(
                depth=_DEPTH,
                reliability=ReliabilityPolicy.BEST_AVAILABLE,
                durability=DurabilityPolicy.BEST_AVAILABLE,
            )
            # rclpy passes the message info to callbacks with two arguments.
            return self._node.create_subscription(
                self._kind,
                self._name,
                self._receive,  # type: ignore[arg-type]
                wish,
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=self._on_incompatible, **more
                ),
                qos_overriding_options=QoSOverridingOptions(_OVERRIDABLE, callback=resolve),
            )

        try:
            return subscribe(message_lost=self._on_lost)
        except UnsupportedEventTypeError:  # Then only sequence numbers count the losses.
            return subscribe()

    def _best(self) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
        reliability, durability = matching(
            [info.qos_profile for info in self._node.get_publishers_info_by_topic(self.topic)]
        )
        asked_reliability, asked_durability = self._asked
        if asked_reliability != ReliabilityPolicy.BEST_AVAILABLE:
            reliability = asked_reliability
        if asked_durability != DurabilityPolicy.BEST_AVAILABLE:
            durability = asked_durability
        return reliability, durability

    def _receive(self, message: Any, info: dict[str, Any]) -> None:
        self._numbers.count(info['publication_sequence_number'], lambda: self.publishers <= 1)
        self._callback(message)

    def _on_lost(self, event: Any) -> None:
        self._reported = event.total_count

    def _on_incompatible(self, _event: Any) -> None:
        # Without parameters, `follow` will request a weaker QoS.
        if self._asked != (ReliabilityPolicy.BEST_AVAILABLE, DurabilityPolicy.BEST_AVAILABLE):
            self._node.get_logger().warning(
                f'{self.topic}: a publisher offers less than qos_overrides.{self.topic}.'
                'subscription.* asks for: no message of it arrives'
            )

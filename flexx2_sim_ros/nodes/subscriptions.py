"""Subscriptions that fit whatever publishes, and that count what they lose."""

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

# As many as most publishers keep: a reliable message that was lost on the way is sent again as
# long as both sides have room for those that came after it.
_DEPTH = 10
_OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)


def matching(offers: Sequence[QoSProfile]) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    """
    Return the strongest reliability and durability that match every publisher.

    Parameters
    ----------
    offers : sequence of QoSProfile
        What the topic's publishers offer.

    Returns
    -------
    ReliabilityPolicy, DurabilityPolicy
        Reliable unless a publisher is not; transient local if there are publishers and all are.

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
    """
    Count lost messages by the numbers that a publisher gives its messages.

    Attributes
    ----------
    lost : int
        Messages that are missing between those that came.

    """

    def __init__(self) -> None:
        """Start with nothing lost."""
        self.lost = 0
        self._last: int | None = None

    def count(self, number: int | None, alone: Callable[[], bool]) -> None:
        """
        Take the number of a message that has come.

        Parameters
        ----------
        number : int or None
            The publisher's number, None where the middleware has none.
        alone : callable
            Returns whether the topic has one publisher: numbers of several say nothing.

        """
        if number is not None and self._last is not None and number > self._last + 1 and alone():
            self.lost += number - self._last - 1
        self._last = number


class Input:
    """
    A subscription that follows what its topic's publishers offer.

    A reliable subscription gets nothing from a best-effort publisher, a best-effort one loses
    what is larger than the publisher's shared memory, and a volatile one misses what was
    latched before. So the subscription asks for the most that all publishers offer, and is
    made again when that changes. ROS parameters (``qos_overrides.<topic>.subscription.*``) fix
    what they set; their default is ``best_available``.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscribes.
    kind : type
        Of the messages.
    topic : str
        Its name, before remapping.
    callback : callable
        Called with every message.

    Attributes
    ----------
    topic : str
        The name after remapping.

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
        """Return how many messages did not arrive, as far as the middleware can tell."""
        return self._lost_before + max(self._reported, self._numbers.lost)

    @property
    def publishers(self) -> int:
        """Return how many publishers the topic has."""
        return self._node.count_publishers(self.topic)

    def follow(self) -> None:
        """Subscribe again if the publishers now offer more, or less, than is asked for."""
        current = self._subscription.qos_profile
        # While nobody publishes, what was right stays: the same publisher may come back.
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
            # rclpy passes what is known of a message to callbacks of two arguments.
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
        except UnsupportedEventTypeError:  # Then the numbers of messages have to do.
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
        # Without parameters, `follow` is about to ask for less.
        if self._asked != (ReliabilityPolicy.BEST_AVAILABLE, DurabilityPolicy.BEST_AVAILABLE):
            self._node.get_logger().warning(
                f'{self.topic}: a publisher offers less than qos_overrides.{self.topic}.'
                'subscription.* asks for: no message of it arrives'
            )

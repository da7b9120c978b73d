"""An executor that does little between messages: that of rclpy takes longer than a frame."""

from collections.abc import Iterable
from itertools import chain
import time
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.subscription import Subscription

_LOOK_SECONDS = 0.5
_WITH_INFO = Subscription.CallbackType.WithMessageInfo


class MessageExecutor(SingleThreadedExecutor):
    """
    Run the callbacks of nodes that exchange many messages, in one thread.

    rclpy makes a new wait set for each callback, of all that its nodes have. Here it is kept until
    subscriptions, timers, services or clients change, and callbacks of messages and timers are
    called at once; they must be no coroutines. The rest is left to rclpy: requests when they come;
    twice a second the events of publishers and subscriptions, which remain until they are handled,
    and guard conditions of nodes.
    """

    def __init__(self, *, context: Any = None) -> None:
        """Wait for nothing yet; ``context`` is that of the nodes, if not the default."""
        super().__init__(context=context)
        self._parts: list[tuple[Any, ...]] = []
        self._waits: Any = None
        self._looked = float('-inf')

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for callbacks, at most ``timeout_sec`` if it is given, and run all that are due."""
        now = time.monotonic()
        if now - self._looked >= _LOOK_SECONDS:
            self._looked = now
            super().spin_once(0.0)
        if self._wait(-1 if timeout_sec is None else int(timeout_sec * 1e9)):
            super().spin_once(0.0)

    def _wait(self, timeout: int) -> bool:
        # Whether there is work for rclpy. `timeout` is in nanoseconds, -1 for none.
        subscriptions, timers, services, clients = self._parts_now()
        handle: Any = self._context.handle
        with handle:
            waits = self._waits
            waits.clear_entities()
            waits.add_guard_condition(self._guard.handle)
            waits.add_guard_condition(self._sigint_gc.handle)
            for add, entities in (
                (waits.add_subscription, subscriptions),
                (waits.add_timer, timers),
                (waits.add_service, services),
                (waits.add_client, clients),
            ):
                for entity in entities:
                    add(entity.handle)
            waits.wait(timeout)
            if not self._context.ok():
                raise ExternalShutdownException()
            for timer in _ready(waits, 'timer', timers):
                if timer.handle.is_timer_ready():
                    timer.handle.call_timer()
                    timer.callback()
            for subscription in _ready(waits, 'subscription', subscriptions):
                _take(subscription)
            return any(
                waits.get_ready_entities(kind) for kind in ('service', 'client', 'guard_condition')
            )

    def _parts_now(self) -> list[tuple[Any, ...]]:
        nodes = self.get_nodes()
        parts = [
            tuple(chain.from_iterable(getattr(node, kind) for node in nodes))
            for kind in ('subscriptions', 'timers', 'services', 'clients')
        ]
        if parts != self._parts or self._waits is None:
            subscriptions, timers, services, clients = map(len, parts)
            # The two guard conditions say that there is something new, or a signal.
            self._waits = _rclpy.WaitSet(
                subscriptions, 2, timers, clients, services, 0, self._context.handle
            )
            self._parts = parts
        return parts


def _ready(waits: Any, kind: str, entities: Iterable[Any]) -> list[Any]:
    pointers = waits.get_ready_entities(kind)
    return [one for one in entities if one.handle.pointer in pointers] if pointers else []


def _take(subscription: Any) -> None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        with_info = subscription._callback_type is _WITH_INFO
        subscription.callback(*taken if with_info else taken[:1])

"""Frames that wait until they are as old as a camera's frames are when they arrive."""

from collections import deque
from collections.abc import Callable

from rclpy.node import Node

_SECOND = 1_000_000_000
# Stamps that are farther than this from the node's clock are taken for those of another clock.
_OTHER_CLOCK = 2 * _SECOND
# Memory is bounded while the clock stands still: so many frames may wait, or as many as come until
# the new one is due and some more, but no more than the last number (about a gigabyte).
_USUAL, _MORE, _MOST = 256, 16, 1024


class LateFrames:
    """
    Publish each frame when the node's clock has reached its stamp plus a delay.

    Frames stay in order. The node's clock is that of ``/clock`` with ``use_sim_time``. If the
    stamps are those of another clock, a frame waits for the delay after it was made. The oldest
    frames are dropped when too many wait, as while the clock stands still, and all of them when it
    is set back by more than two seconds. ``other_clock`` says whether the stamp of the last frame
    was of another clock, ``dropped`` how many frames were dropped.
    """

    def __init__(self, node: Node) -> None:
        """Wait for frames."""
        self._node = node
        self._waiting: deque[tuple[int, Callable[[], None]]] = deque()
        self._timer = node.create_timer(1.0, self._publish_due, autostart=False)
        self._most = _USUAL
        self.other_clock = False
        self.dropped = 0
        self._last = 0

    @property
    def clock(self) -> int:
        """Return the time of the node's clock, nanoseconds."""
        return int(self._node.get_clock().now().nanoseconds)

    @property
    def waiting(self) -> int:
        """Return how many frames wait."""
        return len(self._waiting)

    def add(self, stamp: int, delay: int, rate_hz: float, publish: Callable[[], None]) -> None:
        """
        Publish a frame when it is due; at once if it is due already.

        Stamp and delay are nanoseconds. At most ``rate_hz`` frames a second come. ``publish`` must
        not raise.
        """
        now = self._now()
        if not (delay or self._waiting):
            publish()
            return
        self.other_clock = abs(now - stamp) > _OTHER_CLOCK
        due = (now if self.other_clock else stamp) + delay
        if self._waiting:
            due = max(due, self._waiting[-1][0])
        # It does not shrink while frames wait: those of a longer delay are due later.
        coming = int(max(due - now, 0) * rate_hz / _SECOND) + _MORE
        self._most = max(self._most if self._waiting else _USUAL, min(coming, _MOST))
        while len(self._waiting) >= self._most:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append((due, publish))
        self._publish_due()

    def clear(self) -> None:
        """Forget the frames that wait."""
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._timer.cancel()

    def _publish_due(self) -> None:
        now = self._now()
        while self._waiting and self._waiting[0][0] <= now:
            self._waiting.popleft()[1]()
        self._timer.cancel()
        if self._waiting:
            self._timer.timer_period_ns = self._waiting[0][0] - now
            self._timer.reset()

    def _now(self) -> int:
        now = self.clock
        if now < self._last - _OTHER_CLOCK:
            # What waits is due in a time that may never come.
            self.dropped += len(self._waiting)
            self._waiting.clear()
        self._last = now
        return now

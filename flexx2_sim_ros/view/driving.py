"""
Drive the robot from a page, with a heartbeat.

A page repeats its velocity while a key is held. A separate thread watches this heartbeat, so that
packing and sending images do not delay the stop.
"""

from collections.abc import Callable
import threading
import time

Velocity = tuple[float, float, float]

# The page repeats its velocity every 0.1 s.
HEARTBEAT_TIMEOUT_SECONDS = 0.35
STOP: Velocity = (0.0, 0.0, 0.0)


class Driving:
    """
    Publish the velocity of a page; stop when the page stops, closes, or misses its heartbeat.

    One page drives at a time. A page that another page stopped or replaced is ignored until it has
    released its keys, that is, until it has sent a stop. ``publish`` takes a velocity: forward and
    to the left in m/s, turn to the left in rad/s. It is called from several threads, never from
    two at once.
    """

    def __init__(self, publish: Callable[[Velocity], None]) -> None:
        """Start the thread; no page drives."""
        self._publish = publish
        self._page: object = None
        self._deadline = 0.0
        self._ignored: set[object] = set()
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def drive(self, page: object, velocity: Velocity) -> bool:
        """
        Handle a page's heartbeat; return whether the robot follows.

        False for a page that must release its keys first.
        """
        with self._changed:
            if self._closed or velocity != STOP and page in self._ignored:
                return False
            if velocity == STOP:
                self._ignored.discard(page)
            if self._page not in (None, page):
                self._ignored.add(self._page)
            self._page = None if velocity == STOP else page
            self._deadline = time.monotonic() + HEARTBEAT_TIMEOUT_SECONDS
            self._publish(velocity)
            self._changed.notify()
            return True

    def leave(self, page: object) -> None:
        """Remove a page that was closed; stop if it drives."""
        with self._changed:
            self._ignored.discard(page)
            if page is self._page:
                self._stop()

    def close(self) -> None:
        """Stop if a page drives, and end the thread."""
        with self._changed:
            self._closed = True
            if self._page is not None:
                self._stop()
            self._changed.notify()
        self._thread.join()

    def _stop(self) -> None:
        self._page = None
        self._publish(STOP)

    def _watch(self) -> None:
        with self._changed:
            while not self._closed:
                if self._page is None:
                    self._changed.wait()
                elif (left := self._deadline - time.monotonic()) > 0:
                    self._changed.wait(left)
                else:
                    self._stop()

"""When the events of publishers are handled."""

import math
import time
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup

_PERIOD = 0.5  # s
_LOOK = 0.02  # s, long enough to wait for events and to handle those that are there


class EventGroup(ReentrantCallbackGroup):
    """
    Let the executor look for events of publishers twice a second only.

    After each callback, rclpy collects all that it waits for anew, and each publisher has two
    events. An event, such as a subscription with an incompatible quality of service, remains until
    it is handled, so it can wait.
    """

    def __init__(self) -> None:
        """Let the first look be at once."""
        super().__init__()
        self._looked = -math.inf

    def can_execute(self, entity: Any) -> bool:
        """Return whether it is time to look."""
        now = time.monotonic()
        if now - self._looked >= _PERIOD:
            self._looked = now
        return now - self._looked < _LOOK

"""Ticks of simulated time that are due, at a factor of real time."""

import time

_NANOSECONDS = 1_000_000_000
# A delay of more than this (real seconds) is given up: time continues from now.
_PATIENCE = 0.25
# Most ticks made at once to catch up.
_AT_ONCE = 2


class Pacer:
    """
    Count ticks. Tick k is at the simulated time k / rate, independent of pace and pauses.

    ``tick`` is the number of ticks so far, ``lag`` the real seconds given up so far because ticks
    took too long.
    """

    def __init__(self, rate_hz: float) -> None:
        """Start at tick 0, now, in real time."""
        # Rates are exact in milli-hertz.
        self._millihertz = round(rate_hz * 1000)
        self.tick = 0
        self.lag = 0.0
        self.restart(1.0)

    def restart(self, factor: float) -> None:
        """Continue from now at a factor of real time."""
        self._factor = factor
        self._origin = time.monotonic(), self.tick

    @property
    def period(self) -> float:
        """Return the real time between ticks, seconds."""
        return 1000.0 / (self._millihertz * self._factor)

    @property
    def stamp(self) -> int:
        """Return the simulated nanoseconds of the last tick."""
        return self.tick * 1000 * _NANOSECONDS // self._millihertz

    def tick_at(self, stamp: int) -> int:
        """Return the last tick at or before a simulated time in nanoseconds."""
        return ((stamp + 1) * self._millihertz - 1) // (1000 * _NANOSECONDS)

    def due(self) -> int:
        """Return how many ticks to make now: none, one, or two to catch up."""
        start, tick = self._origin
        late = (time.monotonic() - start) / self.period - (self.tick - tick)
        if late * self.period > _PATIENCE + self.period:
            # One of them is made now, the others are given up.
            self.lag += (late - 1) * self.period
            self._origin = time.monotonic(), self.tick + 1
            return 1
        return min(max(int(late), 0), _AT_ONCE)

"""Pacing: which inputs become frames, at what rate they arrive, which simulated ticks are due."""

from collections import deque
from itertools import pairwise
from statistics import median
import time

_NANOSECONDS = 1_000_000_000
# A gap of this many usual periods, and of at least a second, is a pause.
_PAUSE_PERIODS = 5
# How early an input may be, in periods of the mode: two stamps, each off by a third, and rounding.
_EARLY = 0.67
# How early an input may be that is faster than the mode, in periods of the input: less than half,
# because at exactly half the rounding of the stamps would choose.
_NEAREST = 0.45
# How many periods of the input tell how fast it is.
_INTERVALS = 31
# A delay of more than this (real seconds) is given up: time continues from now.
_PATIENCE = 0.25
# Most ticks made at once to catch up.
_AT_ONCE = 2


class FrameGate:
    """
    Select the inputs that become frames at a mode's rate, by their stamps.

    Frames are due at ``origin + k / rate`` in whole nanoseconds, so there is no drift. An input
    may be up to two thirds of a period early: all inputs at the mode's rate become frames if no
    stamp is off by more than a third of the period. If the last inputs came faster than that,
    the input nearest to the due time becomes the frame. If the input is slower than the rate, all
    of it is accepted. After a gap, the timing continues from the first input. A stamp that goes
    back (a simulation was reset) restarts it.

    Attributes
    ----------
    early, repeats, restarts : int
        Number of inputs that were not due yet, of inputs with the stamp of the one before, and of
        stamps that went back.
    standing : int
        Number of repeats since the last new stamp.

    """

    def __init__(self, rate_hz: float) -> None:
        """Wait for the first frame."""
        self.early = 0
        self.repeats = 0
        self.restarts = 0
        self.standing = 0
        self._last_input: int | None = None
        self._last_output: int | None = None
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)
        self.set_rate(rate_hz)

    def set_rate(self, rate_hz: float) -> None:
        """Change the rate; the next frame is due one new period after the last one."""
        # Rates are exact in milli-hertz.
        self._millihertz = round(rate_hz * 1000)
        self._period = round(_NANOSECONDS / rate_hz)
        self._origin = self._last_output
        self._next = 1

    def accept(self, stamp: int) -> bool:
        """
        Return whether the input with this stamp (nanoseconds) becomes a frame.

        An input with the same stamp as the last one does not.
        """
        if self._last_input is not None:
            if stamp == self._last_input:
                self.repeats += 1
                self.standing += 1
                return False
            if stamp < self._last_input:
                self.restarts += 1
                self._origin = None
            else:
                self._intervals.append(stamp - self._last_input)
        self._last_input = stamp
        self.standing = 0
        if self._origin is None:
            self._origin, self._next = stamp, 0
        elif stamp + self._tolerance() < self._due(self._next):
            self.early += 1
            return False
        elif stamp >= self._due(self._next + 1):
            self._origin, self._next = stamp, 0
        self._next += 1
        self._last_output = stamp
        return True

    def _tolerance(self) -> int:
        # A gap must not hide that the inputs before it were fast.
        elapsed = sum(min(interval, 2 * self._period) for interval in self._intervals)
        count, early = len(self._intervals), int(_EARLY * self._period)
        if elapsed >= count * self._period - early:
            return early
        return int(_NEAREST * elapsed / count)

    def _due(self, slot: int) -> int:
        assert self._origin is not None
        return self._origin + slot * 1000 * _NANOSECONDS // self._millihertz


class RateMeter:
    """
    Measure a rate from the last 120 stamps.

    Only stamps after the last pause (or jump of the clock) count.
    """

    def __init__(self) -> None:
        """Start without stamps."""
        self._stamps: deque[int] = deque(maxlen=120)

    def add(self, stamp: int) -> None:
        """Add a stamp (nanoseconds); a stamp that goes back discards the earlier ones."""
        if self._stamps and stamp < self._stamps[-1]:
            self._stamps.clear()
        self._stamps.append(stamp)

    def clear(self) -> None:
        """Discard all stamps."""
        self._stamps.clear()

    @property
    def samples(self) -> int:
        """Return the number of stamps that the rate is computed from."""
        return len(self._recent())

    @property
    def hz(self) -> float:
        """Return the rate in Hz; 0 with fewer than two stamps."""
        recent = self._recent()
        if len(recent) < 2 or recent[-1] == recent[0]:
            return 0.0
        return (len(recent) - 1) * _NANOSECONDS / (recent[-1] - recent[0])

    def _recent(self) -> list[int]:
        stamps = list(self._stamps)
        periods = [later - sooner for sooner, later in pairwise(stamps)]
        if periods:
            pause = max(_NANOSECONDS, _PAUSE_PERIODS * median(periods))
            for index in reversed(range(len(periods))):
                if periods[index] > pause:
                    return stamps[index + 1 :]
        return stamps


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

"""Frame timing by header stamps: which inputs become frames, and how fast they come."""

from collections import deque
from itertools import pairwise
from statistics import median

_NANOSECONDS = 1_000_000_000
# So many usual periods without a stamp are a pause, if they last a second.
_PAUSE_PERIODS = 5


class FrameGate:
    """
    Let frames through at a mode's rate, by their stamps.

    Frames are due at ``origin + k / rate`` in whole nanoseconds, so there is no drift. An input
    up to a fifth of a period early is let through, since stamps are rounded and jitter, unless
    the next one will be nearer to the due time. Input slower than the rate passes whole. A stamp
    that goes back (a simulation was reset) starts afresh.

    Parameters
    ----------
    rate_hz : float
        The mode's frame rate.

    Attributes
    ----------
    early, repeats, restarts : int
        Inputs that were not due yet, that had the stamp of the one before, and times that the
        stamps went back.

    """

    def __init__(self, rate_hz: float) -> None:
        """Wait for the first frame."""
        self.early = 0
        self.repeats = 0
        self.restarts = 0
        self._last_input: int | None = None
        self._last_output: int | None = None
        self.set_rate(rate_hz)

    def set_rate(self, rate_hz: float) -> None:
        """Change the rate; the next frame is due one new period after the last one."""
        # Rates are exact in milli-hertz.
        self._millihertz = round(rate_hz * 1000)
        self._tolerance = round(_NANOSECONDS / rate_hz / 5)
        self._origin = self._last_output
        self._next = 1

    def accept(self, stamp: int) -> bool:
        """
        Say whether the input with this stamp (nanoseconds) is a frame.

        A stamp equal to the last one is a repetition and is not.
        """
        tolerance = self._tolerance
        if self._last_input is not None:
            if stamp == self._last_input:
                self.repeats += 1
                return False
            if stamp < self._last_input:
                self.restarts += 1
                self._origin = None
            else:
                tolerance = min(tolerance, (stamp - self._last_input) // 2)
        self._last_input = stamp
        if self._origin is None:
            self._origin, self._next = stamp, 1
            self._last_output = stamp
            return True
        if stamp + tolerance < self._due(self._next):
            self.early += 1
            return False
        if stamp >= self._due(self._next + 1):
            # Due times have passed without an input: leave them out.
            elapsed = stamp + tolerance - self._origin
            self._next = elapsed * self._millihertz // (1000 * _NANOSECONDS)
        self._next += 1
        self._last_output = stamp
        return True

    def _due(self, slot: int) -> int:
        assert self._origin is not None
        return self._origin + slot * 1000 * _NANOSECONDS // self._millihertz


class RateMeter:
    """
    Measure a rate from stamps, over the last 120 of them.

    A pause, or a clock that was set forward, is no part of a rate: only the stamps after it count.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._stamps: deque[int] = deque(maxlen=120)

    def add(self, stamp: int) -> None:
        """Take a stamp (nanoseconds) in; one that goes back starts afresh."""
        if self._stamps and stamp < self._stamps[-1]:
            self._stamps.clear()
        self._stamps.append(stamp)

    def clear(self) -> None:
        """Start afresh."""
        self._stamps.clear()

    @property
    def samples(self) -> int:
        """How many stamps the rate rests on."""
        return len(self._recent())

    @property
    def hz(self) -> float:
        """Return the rate in Hz; 0 before there are two stamps."""
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

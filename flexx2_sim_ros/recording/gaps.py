"""Find missing frames of a stream by its stamps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_NEIGHBOURS = 8
_QUARTILE = 12  # of 17 steps: the upper one
# Jitter stays below this many periods; one missing frame makes two.
_GAP_PERIODS = 1.5


@dataclass(frozen=True)
class Gaps:
    """
    Gaps in the stamps of a stream.

    Attributes
    ----------
    count : int
        Number of gaps.
    longest : float
        The longest one, seconds; 0 without gaps.
    returns : int
        Number of stamps that went back or repeated.

    """

    count: int = 0
    longest: float = 0.0
    returns: int = 0


def find_gaps(stamps: Sequence[int]) -> Gaps:
    """
    Compare each step between stamps with those around it.

    The usual step is the upper quartile of the eight steps before and after. So a change of the
    rate is no gap, nor are the alternating steps of a 45 Hz mode with 60 Hz input.

    Parameters
    ----------
    stamps : sequence of int
        Nanoseconds, in the order of the messages.

    Returns
    -------
    Gaps

    """
    steps = np.diff(np.asarray(stamps, np.int64))
    forward = steps[steps > 0]
    returns = len(steps) - len(forward)
    if len(forward) < 3:
        return Gaps(returns=returns)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(forward, _NEIGHBOURS, mode='symmetric'), 2 * _NEIGHBOURS + 1
    )
    usual = np.sort(around, axis=1)[:, _QUARTILE]
    gaps = forward[forward > _GAP_PERIODS * usual]
    return Gaps(len(gaps), float(gaps.max(initial=0)) / 1e9, returns)

"""Frames that are missing from a stream, by its stamps."""

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
    Where a stream's stamps leave something out.

    Attributes
    ----------
    count : int
        How many gaps there are.
    longest : float
        The longest one, seconds; 0 without gaps.
    returns : int
        How often stamps went back or stood still.

    """

    count: int = 0
    longest: float = 0.0
    returns: int = 0


def find_gaps(stamps: Sequence[int]) -> Gaps:
    """
    Compare each step between stamps with those around it.

    The rate is what the eight steps before and after say (their upper quartile, so that a mode
    of 45 Hz out of 60 Hz, whose steps alternate, has no gaps): one that changes is no gap.

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

"""Types of arguments on the command line: numbers in a range."""

import argparse
from collections.abc import Callable
import math

SEEDS = -(2**63), 2**63 - 1
MOST_JOBS = 1024
MOST_FRAMES = 10_000_000  # Four days at 30 Hz.
_LONGEST = 20  # characters of a value that an error repeats


def whole_number(low: int, high: int | None = None) -> Callable[[str], int]:
    """
    Return an argument type: a whole number in a range.

    Parameters
    ----------
    low : int
        The least.
    high : int, optional
        The most; None for any.

    """

    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if value < low or (high is not None and value > high):
            limit = f'of at least {low}' if high is None else f'from {low} to {high}'
            raise argparse.ArgumentTypeError(f'must be a whole number {limit}, got {_short(text)}')
        return value

    return convert


def number(low: float, high: float, *, above: bool = False) -> Callable[[str], float]:
    """
    Return an argument type: a finite number in a range.

    Parameters
    ----------
    low, high : float
        The least and the most.
    above : bool
        Whether `low` itself is out of range.

    """

    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low <= value <= high) or (above and value == low):
            limit = f'above {low:g}, up to {high:g}' if above else f'from {low:g} to {high:g}'
            raise argparse.ArgumentTypeError(f'must be a number {limit}, got {_short(text)}')
        return value

    return convert


def _short(text: str) -> str:
    return repr(text if len(text) <= _LONGEST else f'{text[:_LONGEST]}...')

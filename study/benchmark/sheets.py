"""Tables of text, and numbers as the tables show them."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from study.benchmark.scoring import wilson


@dataclass(frozen=True)
class Sheet:
    """A table: title, column names, rows of text."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def percent(hits: int, count: int, form: str = '.0f') -> str:
    """Return a rate (in this form) with its 95 % interval and the count, as text."""
    if not count:
        return '-'
    low, high = wilson(hits, count)
    return f'{100 * hits / count:{form}} % [{100 * low:.0f}-{100 * high:.0f}] of {count}'


def known(values: Sequence[float]) -> list[float]:
    """Return the values that are not NaN."""
    return [value for value in values if not math.isnan(value)]


def mean(values: Sequence[float], form: str = '.2f') -> str:
    """Return the mean of the values that are not NaN, and their count, as text."""
    some = known(values)
    return f'{np.mean(some):{form}} ({len(some)})' if some else '-'


def most_common(words: Sequence[str]) -> str:
    """Return the word that occurs most often, the first of several; empty for none."""
    return max(words, key=words.count) if words else ''

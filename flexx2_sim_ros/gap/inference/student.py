"""Student's t without SciPy, and false-discovery rates."""

from functools import lru_cache
import math

import numpy as np


@lru_cache(maxsize=64)
def _table(degrees: int) -> tuple[np.ndarray, np.ndarray]:
    # t = tan(x) makes the density smooth and the range finite.
    x = np.linspace(0, math.pi / 2, 20001)[:-1]
    t = math.sqrt(degrees) * np.tan(x)
    density = np.cos(x) ** (degrees - 1)
    tail = np.concatenate([np.cumsum(density[::-1])[::-1], [0.0]])
    return np.append(t, np.inf), tail / (2 * tail[0])


def t_tail(t: np.ndarray, degrees: int) -> np.ndarray:
    """Return the probability of more than t (0 or more), Student's t."""
    places, tail = _table(max(degrees, 1))
    return np.interp(np.minimum(t, places[-2]), places[:-1], tail[:-1])


def t_quantile(probability: float, degrees: int) -> float:
    """Return the t that is exceeded with 1 - probability (above one half)."""
    places, tail = _table(max(degrees, 1))
    return float(np.interp(-(1 - probability), -tail[:-1], places[:-1]))


def q_values(p: np.ndarray) -> np.ndarray:
    """Return Benjamini and Hochberg's false-discovery rates for p-values."""
    order = np.argsort(p)
    ranked = p[order] * len(p) / np.arange(1, len(p) + 1)
    out = np.empty_like(p)
    out[order] = np.minimum(np.minimum.accumulate(ranked[::-1])[::-1], 1.0)
    return out

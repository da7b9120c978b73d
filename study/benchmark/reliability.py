"""Whether probabilities are right: bins of a reliability diagram, and the calibration error."""

from collections.abc import Sequence
import math

import numpy as np

BINS = 10
_DRAWS = 200

Pairs = Sequence[tuple[float, bool]]  # a probability, and whether it came true


def bins(pairs: Pairs) -> list[tuple[float, float, Pairs]]:
    """
    Divide probabilities into bins of equal width.

    Returns the lower limit, the upper limit, and the pairs of each bin that has any.
    """
    places = [min(int(said * BINS), BINS - 1) for said, _ in pairs]
    out: list[tuple[float, float, Pairs]] = []
    for k in range(BINS):
        some = [pair for pair, place in zip(pairs, places, strict=True) if place == k]
        if some:
            out.append((k / BINS, (k + 1) / BINS, some))
    return out


def calibration_error(pairs: Pairs) -> float:
    """Return the expected calibration error: bins of equal width, weighted by their number."""
    if not pairs:
        return math.nan
    gaps = [abs(sum(said - true for said, true in some)) for _, _, some in bins(pairs)]
    return float(sum(gaps) / len(pairs))


def least_calibration_error(pairs: Pairs) -> float:
    """Return the mean `calibration_error` of true probabilities, which chance alone causes."""
    if not pairs:
        return math.nan
    said = np.array([p for p, _ in pairs])
    rng = np.random.default_rng(0)
    draws = [
        calibration_error(list(zip(said, rng.random(len(said)) < said, strict=True)))
        for _ in range(_DRAWS)
    ]
    return float(np.mean(draws))

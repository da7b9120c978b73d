"""How far a simulation is from a recording, in the units of consumers, with intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_SETS = 2000  # of recordings, drawn with replacement
QUANTILES = 0.05, 0.95  # of intervals
FEWEST = 3  # recordings for an interval
# Renditions: the recording, its simulation, another one, and that with all effects.
REAL, SIMULATED, AGAIN, ALL = 'real', 'simulated', 'again', 'all effects'
Interval = tuple[float, float] | None


@dataclass(frozen=True)
class Left:
    """
    What remains of a difference with some effects.

    Attributes
    ----------
    value : float
        Mean error of the consumer on the simulation with these effects.
    difference : float
        Mean absolute difference from the recordings.
    share : float
        Fraction of the difference without effects that these effects take away; negative where
        they add to it.
    interval : tuple of float or None
        90 % interval of the share, a bootstrap over recordings; None for fewer than three.
    part : float
        Fraction of what all effects together change that these change as well; negative where
        they change the opposite. Simulations have the same noise, so noise does not lower it.

    """

    value: float
    difference: float
    share: float
    interval: Interval
    part: float


@dataclass(frozen=True)
class Compared:
    """
    One measure of one consumer.

    Attributes
    ----------
    recordings : int
        How many show it.
    real, simulated : float
        Mean error of the consumer on the recordings and on their simulation without effects.
    difference : float
        Mean absolute difference of the two, recording by recording.
    interval : tuple of float or None
        90 % interval of the difference.
    null : float
        The same difference of two simulations without effects.
    significant : bool
        Whether the difference exceeds that of two simulations in 95 % of the sets of recordings.
        False with fewer than three recordings.
    all_effects : Left
        What remains with all effects together.
    effects : dict of str to Left
        What remains with each effect alone.

    """

    recordings: int
    real: float
    simulated: float
    difference: float
    interval: Interval
    null: float
    significant: bool
    all_effects: Left
    effects: dict[str, Left]


def compare(
    rows: Sequence[Mapping[str, Mapping[str, float]]], measure: str, effects: Sequence[str]
) -> Compared | None:
    """
    Compare a consumer's errors on recordings with those on their simulations.

    ``rows`` have, for each recording, by rendition, errors by name; ``measure`` is which error.
    Besides `REAL`, `SIMULATED`, `AGAIN` and `ALL` there is a rendition with each of ``effects``
    alone, of the same name. None if no recording shows the measure in all renditions.
    """
    wanted = [REAL, SIMULATED, AGAIN, ALL, *effects]
    used = [row for row in rows if _shows(row, measure, wanted)]
    if not used:
        return None
    values = np.array([[row[name][measure] for name in wanted] for row in used])  # (R, renditions)
    real, simulated = values[:, 0], values[:, 1]
    apart = np.abs(values[:, 1:] - values[:, :1])  # from the recording
    without, null = apart[:, 0], np.abs(values[:, 2] - simulated)
    sets = np.random.default_rng(0).integers(len(used), size=(_SETS, len(used)))
    enough = len(used) >= FEWEST
    excess = (without - null)[sets].mean(axis=1)
    left = {}
    every = np.abs(values - values[:, [wanted.index(ALL)]]).mean(axis=0)
    for k, name in enumerate(wanted[3:], start=2):
        shares = _share(apart[:, k][sets].mean(axis=1), without[sets].mean(axis=1))
        left[name] = Left(
            float(values[:, k + 1].mean()),
            float(apart[:, k].mean()),
            float(_share(apart[:, k].mean(), without.mean())),
            _interval(shares) if enough else None,
            float(_share(every[k + 1], every[1])),
        )
    return Compared(
        len(used),
        float(real.mean()),
        float(simulated.mean()),
        float(without.mean()),
        _interval(without[sets].mean(axis=1)) if enough else None,
        float(null.mean()),
        enough and bool(np.quantile(excess, QUANTILES[0]) > 0),
        left.pop(ALL),
        left,
    )


def parts(
    rows: Sequence[Mapping[str, Mapping[str, float]]], measure: str, effects: Sequence[str]
) -> np.ndarray:
    """
    Return what effects change of a measure, for many bootstrap sets of the recordings.

    The sets are the same for all measures of the same recordings, so the parts of a set can be
    averaged over measures and compared between effects. Parameters are as for `compare`. Returned
    is (S, E) float64 `Left.part` of each effect in each set, limited to -1 to 1.
    """
    wanted = [SIMULATED, ALL, *effects]
    used = np.array([_shows(row, measure, [REAL, AGAIN, *wanted]) for row in rows])
    values = np.array(
        [
            [row[name][measure] for name in wanted] if shown else [0.0] * len(wanted)
            for row, shown in zip(rows, used, strict=True)
        ]
    )
    apart = np.abs(values - values[:, [1]])  # from the simulation with all effects
    even = np.full(len(rows), 1 / len(rows))
    sets = np.random.default_rng(0).multinomial(len(rows), even, size=_SETS)
    left = sets @ apart
    return np.clip(_share(left[:, 2:], left[:, :1]), -1, 1)


def _shows(row: Mapping[str, Mapping[str, float]], measure: str, wanted: Sequence[str]) -> bool:
    return all(measure in row[name] for name in wanted)


def _share(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    return np.where(before > 0, 1 - after / np.where(before > 0, before, 1), 0.0)


def _interval(values: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(values, QUANTILES)
    return float(low), float(high)

"""
What ``config/decisions.yaml`` says: probabilities, thresholds and margins of intervals.

They were calibrated on simulated campaigns; the file names the command, the seeds and the rates
of errors that it reached.
"""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.paths import config_dir

FILE = 'decisions.yaml'
_FEWEST = 2  # recordings of a campaign that the margins were calibrated on


@dataclass(frozen=True)
class Logistic:
    """A logistic model: log odds are a constant plus a weighted sum of evidence, by its name."""

    constant: float
    weights: Mapping[str, float]

    def log_odds(self, evidence: Mapping[str, float]) -> float:
        """Return the logarithm of the odds, given the evidence by name."""
        weighted = (weight * evidence[name] for name, weight in self.weights.items())
        return self.constant + sum(weighted)

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Return the probability, 0..1, given the evidence by name."""
        odds = self.log_odds(evidence)
        return 1 / (1 + math.exp(-min(max(odds, -500.0), 500.0)))


@dataclass(frozen=True)
class Margin:
    """
    By how much 90 % intervals of the reduction are widened in one group of campaigns.

    * `verdict`: ``identified`` or ``partly``.
    * `most`: largest number of recordings of the group.
    * `least_depths`: smallest number of depths per recording of the group.
    * `margin`: added to each end; negative where the intervals were too wide. None where there
      were too few campaigns of the group.
    """

    verdict: str
    most: int
    least_depths: float
    margin: float | None


@dataclass(frozen=True)
class GapThresholds:
    """
    From which evidence on there is a gap.

    * `probability`: that there is a gap.
    * `excess`, `excess_per_scatter`: excess loss. The wrong poses of a campaign leave more loss
      the more they scatter.
    * `agreement`: see `probability.agreement`.
    * `most_depths`: the thresholds above are those of campaigns with so many depths per recording,
      or more.
    * `odds_per_fewer`, `excess_per_fewer`: fewer depths leave more loss by chance. For each factor
      e of depths that are fewer, by how much the logarithm of the odds and the excess loss must be
      larger.
    """

    probability: float
    excess: float
    excess_per_scatter: float
    agreement: float
    most_depths: float
    odds_per_fewer: float
    excess_per_fewer: float

    def excess_from(self, scatter: float, depths: float) -> float:
        """
        Return the excess loss from which on there is a gap.

        `scatter` is that of the poses; `depths` are per recording.
        """
        more = self.excess_per_fewer * fewer_by(depths, self.most_depths)
        return self.excess + self.excess_per_scatter * scatter + more

    def probability_from(self, depths: float) -> float:
        """Return the probability from which on there is a gap; ``depths`` are per recording."""
        more = self.odds_per_fewer * fewer_by(depths, self.most_depths)
        return times_odds(self.probability, math.exp(more))


# Of the table `gap` of the file, by field.
KEYS = {one.name: one.name for one in fields(GapThresholds)} | {'probability': 'threshold'}


@dataclass(frozen=True)
class Decisions:
    """
    The calibrated rule of the verdict.

    * `gap`: that there is a gap.
    * `effect`, `rival`: where there is one: that a chosen effect is present; that another one is,
      which could be in place of the last one chosen.
    * `least_effect`: probability from which on effects are named.
    * `least_alternative`: probability from which on an effect is listed as an alternative.
    * `margins`: the first one that a campaign belongs to counts.
    * `nulls`: `gap_score` of the campaigns without an effect, ascending.
    """

    gap: Logistic
    effect: Logistic
    rival: Logistic
    thresholds: GapThresholds
    least_effect: float
    least_alternative: float
    margins: tuple[Margin, ...]
    nulls: tuple[float, ...] = ()

    def gap_score(self, evidence: Mapping[str, float], depths: float) -> float:
        """
        Return the log odds of a gap that mean as much in a campaign with most depths.

        `depths` are per recording.
        """
        fewer = fewer_by(depths, self.thresholds.most_depths)
        return self.gap.log_odds(evidence) - self.thresholds.odds_per_fewer * fewer

    def p_value(self, evidence: Mapping[str, float], depths: float) -> float:
        """Return the conformal p-value: the rank of `gap_score` among `nulls`, itself counted."""
        at_least = len(self.nulls) - bisect_left(self.nulls, self.gap_score(evidence, depths))
        return (1 + at_least) / (1 + len(self.nulls))

    def widened(
        self,
        interval: Sequence[float] | None,
        middle: float,
        verdict: str,
        recordings: int,
        depths: float,
    ) -> list[float] | None:
        """
        Return a 90 % interval of the reduction of the gap on other scenes, within -1 to 1.

        `interval` is that over recordings, None with fewer than three of them; `middle` the
        predicted reduction; `depths` are per recording. The result is None where too few campaigns
        were like this one. One recording cannot be left out, so that its reduction is no
        prediction.
        """
        if recordings < _FEWEST:
            return None
        for one in self.margins:
            large = depths >= one.least_depths
            if one.verdict == verdict and recordings <= one.most and large:
                if one.margin is None:
                    return None
                low, high = interval or (middle, middle)
                low, high = min(low - one.margin, middle), max(high + one.margin, middle)
                return [max(low, -1.0), min(high, 1.0)]
        return None


def fewer_by(depths: float, most: float) -> float:
    """Return how many times a factor e fewer depths there are than so many, at least 0."""
    return max(math.log(most / depths), 0.0)


def times_odds(probability: float, factor: float) -> float:
    """Return the probability whose odds are so many times as large."""
    return factor * probability / (1 - probability + factor * probability)


@cache
def calibrated() -> Decisions:
    """Return the rule that the package comes with."""
    return read_decisions(config_dir() / FILE)


def read_decisions(path: Path) -> Decisions:
    """
    Return the rule of a file.

    Raises `InputError` when the file cannot be read or a value is missing or wrong.
    """
    table = read_config(path)
    try:
        return Decisions(
            _logistic(table, 'gap'),
            _logistic(table, 'effect'),
            _logistic(table, 'alternative'),
            GapThresholds(**{name: _number(table['gap'], key) for name, key in KEYS.items()}),
            _number(table['effect'], 'threshold'),
            _number(table['alternative'], 'threshold'),
            tuple(
                Margin(
                    str(row['verdict']),
                    int(row['most']),
                    _number(row, 'least_depths'),
                    None if row['margin'] is None else _number(row, 'margin'),
                )
                for row in table['reduction']
            ),
            tuple(sorted(map(float, table['gap']['nulls']))),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f'{shown_path(path)}: must be written by python -m bench.calibrate_decisions: '
            f'{shown(error)}'
        ) from error


def _logistic(table: Mapping[str, Any], name: str) -> Logistic:
    row = table[name]
    weights = {str(key): float(value) for key, value in row['weights'].items()}
    return Logistic(_number(row, 'constant'), weights)


def _number(row: Mapping[str, Any], name: str) -> float:
    value = float(row[name])
    if not math.isfinite(value):
        raise ValueError(f'{name}: must be finite, got {value}')
    return value

"""
What ``config/decisions.yaml`` says: probabilities, thresholds and margins of intervals.

They were calibrated on simulated campaigns; the file names the command, the seeds and the rates
of errors that it reached.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    """
    A logistic model: the log odds are a constant plus a weighted sum of evidence.

    Attributes
    ----------
    constant : float
        Log odds without evidence.
    weights : mapping of str to float
        Log odds for each unit of the evidence, by its name.

    """

    constant: float
    weights: Mapping[str, float]

    def log_odds(self, evidence: Mapping[str, float]) -> float:
        """Return the log odds, given the evidence by name."""
        return self.constant + sum(
            weight * evidence[name] for name, weight in self.weights.items()
        )

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Return the probability, 0..1, given the evidence by name."""
        return 1 / (1 + math.exp(-min(max(self.log_odds(evidence), -500.0), 500.0)))


@dataclass(frozen=True)
class Margin:
    """
    By how much 90 % intervals of the reduction are widened in one group of campaigns.

    Attributes
    ----------
    verdict : str
        ``identified`` or ``partly``.
    most : int
        Largest number of recordings of the group.
    least_depths : float
        Smallest number of depths per recording of the group.
    margin : float or None
        Added to each end; negative where the intervals were too wide. None where there were too
        few campaigns of the group.

    """

    verdict: str
    most: int
    least_depths: float
    margin: float | None


@dataclass(frozen=True)
class GapTest:
    """
    Whether recordings differ from the simulation, as a test against campaigns without an effect.

    A campaign is ranked among them by its log odds of a gap (conformal p-value: Bates et al.,
    Testing for outliers with conformal p-values, 2023).

    Attributes
    ----------
    model : Logistic
        That there is a gap.
    most_depths : float
        Most depths per recording of these campaigns.
    odds_per_fewer : float
        Fewer depths leave more loss by chance: by how much the log odds are lower for each factor
        e of depths that are fewer.
    campaigns : int
        How many campaigns without an effect there were.
    largest : tuple of float
        The largest log odds of them, descending.
    level : float
        There is a gap if the p-value is at most this: the rate of false alarms.

    """

    model: Logistic
    most_depths: float
    odds_per_fewer: float
    campaigns: int
    largest: tuple[float, ...]
    level: float

    def score(self, log_odds: float, depths: float) -> float:
        """Return log odds as they would be with most depths; ``depths`` are per recording."""
        return log_odds - self.odds_per_fewer * fewer_by(depths, self.most_depths)

    def p_value(self, score: float) -> float:
        """Return the fraction of campaigns without an effect whose score is as large, or more."""
        return (1 + sum(one >= score for one in self.largest)) / (1 + self.campaigns)


@dataclass(frozen=True)
class Decisions:
    """
    The calibrated rule of the verdict.

    Attributes
    ----------
    gap : GapTest
        Whether there is a gap.
    effect, rival : Logistic
        Where there is one: that a chosen effect is present; that another one is, which could be in
        place of the last one chosen.
    least_effect : float
        Probability from which on effects are named.
    least_alternative : float
        Probability from which on an effect is listed as an alternative.
    margins : tuple of Margin
        The first one that a campaign belongs to counts.

    """

    gap: GapTest
    effect: Logistic
    rival: Logistic
    least_effect: float
    least_alternative: float
    margins: tuple[Margin, ...]

    def widened(
        self,
        interval: Sequence[float] | None,
        middle: float,
        verdict: str,
        recordings: int,
        depths: float,
    ) -> list[float] | None:
        """
        Return a 90 % interval of the reduction of the gap on other scenes.

        Parameters
        ----------
        interval : sequence of float or None
            The interval over recordings; None with fewer than three recordings.
        middle : float
            The predicted reduction.
        verdict : str
            Of the diagnosis.
        recordings : int
            How many there are.
        depths : float
            Per recording.

        Returns
        -------
        list of float or None
            Within -1 to 1; None where too few campaigns were like this one. One recording
            cannot be left out, so that its reduction is no prediction.

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


@cache
def calibrated() -> Decisions:
    """Return the rule that the package comes with."""
    return read_decisions(config_dir() / FILE)


def read_decisions(path: Path) -> Decisions:
    """
    Return the rule of a file.

    Raises
    ------
    InputError
        When the file cannot be read or a value is missing or wrong.

    """
    table = read_config(path)
    try:
        return Decisions(
            _gap_test(table['gap']),
            _logistic(table['effect']),
            _logistic(table['alternative']),
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
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f'{shown_path(path)}: must be written by python -m bench.calibrate_decisions: '
            f'{shown(error)}'
        ) from error


def _gap_test(row: Mapping[str, Any]) -> GapTest:
    return GapTest(
        _logistic(row),
        _number(row, 'most_depths'),
        _number(row, 'odds_per_fewer'),
        int(row['campaigns']),
        tuple(float(one) for one in row['largest']),
        _number(row, 'level'),
    )


def _logistic(row: Mapping[str, Any]) -> Logistic:
    weights = {str(key): float(value) for key, value in row['weights'].items()}
    return Logistic(_number(row, 'constant'), weights)


def _number(row: Mapping[str, Any], name: str) -> float:
    value = float(row[name])
    if not math.isfinite(value):
        raise ValueError(f'{name}: must be finite, got {value}')
    return value

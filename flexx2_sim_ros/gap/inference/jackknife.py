"""Effects that are as wrong as their fit leaves open."""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from flexx2_sim_ros.effects import loadable
from flexx2_sim_ros.effects.tables import Curve
import numpy as np
from scipy.fft import dct

Settings = dict[str, dict[str, Any]]


def as_wrong_as_fitted(together: Settings, without: Sequence[Settings]) -> list[Settings]:
    """
    Return effects of each recording that are as far from the fitted ones as these from the truth.

    `together` has settings by effect, fitted to all recordings; `without` (R,) the same fitted
    without each recording.

    What poses can take over, a fit leaves open: a lens that is shifted looks like cameras that are
    turned. A recording that was left out does not show it, because its own pose is fitted with the
    effects of the others. The jackknife does: where d are the deviations of the values that were
    fitted without one of n recordings, (n - 1) / n times the sum of d squared is the variance of
    the fitted values (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, eq. 11.5).

    Each recording gets the fitted values plus a sum of all deviations, with factors from a row of
    its own of an orthogonal matrix: the mean of their squares over recordings is this variance.
    With its own deviation alone, the recording that shows an effect most would get the most wrong
    values, because without it they change most.

    No deviation counts more than all others together. If one recording alone says how large a
    value is, the others do not, and what they say without it is no error of the fit with it.
    Effects that poses cannot take over keep the values that were fitted without the recording.
    """
    count = len(without)
    factors = math.sqrt(max(count - 1, 0)) * dct(np.eye(count), norm='ortho')
    return [
        {
            name: _effect(name, together[name], values, [one[name] for one in without], row)
            for name, values in own.items()
        }
        for own, row in zip(without, factors, strict=True)
    ]


def _effect(
    name: str,
    together: Mapping[str, Any],
    own: Mapping[str, Any],
    without: Sequence[Mapping[str, Any]],
    factors: np.ndarray,
) -> dict[str, Any]:
    kind = loadable()[name]
    if 'pose' not in kind.nuisances:
        return dict(own)
    limits = {one.name: (one.low, one.high) for one in kind.parameters()}
    limits |= {key: (one.low, one.high) for key, one in kind.tables().items()}
    return {
        key: _value(
            together.get(key), [one.get(key) for one in without], factors, limits[key], value
        )
        for key, value in own.items()
    }


def _value(
    together: Any,
    without: Sequence[Any],
    factors: np.ndarray,
    limits: tuple[float, float],
    own: Any,
) -> Any:
    # `own` where the values cannot be compared, such as curves over other knots.
    if all(isinstance(one, Curve) for one in (together, *without)):
        if any(one.knots != together.knots for one in without):
            return own
        values = np.array([one.values for one in without])
        moved = np.array(together.values) + factors @ _deviations(values)
        return Curve(together.knots, tuple(np.clip(moved, *limits).tolist()), together.period)
    if all(isinstance(one, float) for one in (together, *without)):
        numbers = np.array(without)
        return float(np.clip(together + factors @ _deviations(numbers), *limits))
    return own


def _deviations(values: np.ndarray) -> np.ndarray:
    # (R, ...) from the mean, each at most the root of the sum of the squares of the others.
    away = values - values.mean(axis=0)
    squares = np.square(away)
    most = np.sqrt(squares.sum(axis=0) - squares)
    return np.asarray(np.clip(away, -most, most))

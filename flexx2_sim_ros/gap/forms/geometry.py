"""Fit the parameters of an effect on geometry together with the pose of each recording."""

from collections.abc import Mapping, Sequence
from typing import Any

from flexx2_sim_ros.effects import parse_effects, registry
from flexx2_sim_ros.effects.shapes import Free, Shape
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.bias_fit import BiasFit
from flexx2_sim_ros.gap.forms.samples import Samples, shift_of
from flexx2_sim_ros.gap.forms.shape_search import Numbers
from flexx2_sim_ros.physics.frame_state import Stage
import numpy as np

_DIGITS = 6  # after the decimal point


def is_fitted_with_poses(effect: str) -> bool:
    """Return whether a calibration fits an effect's parameters together with the poses."""
    kind = registry().get(effect)
    return kind is not None and kind.stage == Stage.GEOMETRY and bool(kind.shapes)


def shape_of(effect: str) -> Shape:
    """Return which parameters of an effect on geometry are fitted."""
    (shape,) = registry()[effect].shapes
    return shape


def slopes_of(
    scene: PlacedScene, place: np.ndarray, effects: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """
    Return how depth changes with the parameters of effects on geometry, by effect.

    That is (K, N) metres for a change of each free parameter of `shape_of` by half of its bounds.
    `place` is (N,) index into the flat images of `samples.shift_of`.
    """
    return {
        name: np.array([_slope(scene, place, name, values, one) for one in shape_of(name).free])
        for name, values in effects.items()
        if is_fitted_with_poses(name)
    }


def next_values(
    effect: str, samples: Sequence[Samples], now: Mapping[str, Any]
) -> tuple[Numbers, tuple[Numbers, ...]]:
    """
    Return an effect's parameters after a step of Gauss and Newton, fitted with all poses.

    They are fitted to all recordings, and to all but one. `samples` have `Samples.slopes` at
    `now`, the effect's parameters, and errors that the effect at `now` and the other effects do
    not explain.
    """
    free = shape_of(effect).free
    # A penalty keeps a step small in a direction of which the recordings say nothing.
    columns = [one.slopes[effect] for one in samples]
    penalty = np.eye(len(free))
    fit = BiasFit(samples).with_usual_poses(columns, penalty)
    step, steps, _ = fit.solve(columns, penalty)
    begin, half = _values(effect, now), np.array([_half(one) for one in free])

    def numbers(change: np.ndarray) -> Numbers:
        return {
            one.name: float(np.clip(round(value, _DIGITS), one.low, one.high))
            for one, value in zip(free, begin + change * half, strict=True)
        }

    return numbers(step), tuple(map(numbers, steps))


def is_settled(effect: str, last: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    """Return whether a step changed each parameter of an effect by so little that it is found."""
    changes = np.abs(_values(effect, now) - _values(effect, last))
    limits = [FORMS.close * (one.high - one.low) for one in shape_of(effect).free]
    return bool((changes < limits).all())


def _values(effect: str, settings: Mapping[str, Any]) -> np.ndarray:
    (whole,) = parse_effects({effect: settings})
    return np.array([getattr(whole, one.name) for one in shape_of(effect).free])


def _slope(
    scene: PlacedScene, place: np.ndarray, effect: str, values: Mapping[str, Any], free: Free
) -> np.ndarray:
    # By a central difference about what the effect is now, within the bounds.
    step = FORMS.slope * _half(free)
    now = _values(effect, values)[shape_of(effect).free.index(free)]
    now = np.clip(now, free.low + step, free.high - step)
    low, high = (
        shift_of(scene, {effect: {**values, free.name: float(value)}})
        for value in (now - step, now + step)
    )
    return np.asarray((high - low).ravel()[place] / (2 * FORMS.slope), np.float64)


def _half(free: Free) -> float:
    return (free.high - free.low) / 2

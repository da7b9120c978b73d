"""Curves of the noise: the factor on sigma_z over amplitude or incidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import of_role, parse_effects
from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.axes import AXES, Axes
from flexx2_sim_ros.gap.features.physical import Measures, SURFACES
import numpy as np

NAME = of_role('sigma').name
# Field of the effect, and the covariate that its curve is over.
FIELDS = {'curve': 'log_amplitude', 'slant': 'incidence'}
WORDS = {'curve': 'amplitude', 'slant': 'incidence'}


@dataclass(frozen=True)
class NoiseCurves:
    """
    The noise of a recording on surfaces, beside that of its simulation; by field of the effect.

    * `middles`: (B,) middles of the bins.
    * `simulated`: (B,) factor on sigma_z in the simulation; NaN where it varies in a bin.
    * `level`: (B,) ln of the measured variance over that of the base model, NaN where too little
      is known.
    * `count`: (B,) pairs of frames.
    """

    middles: dict[str, np.ndarray]
    simulated: dict[str, np.ndarray]
    level: dict[str, np.ndarray]
    count: dict[str, np.ndarray]


def noise_of(
    axes: Axes, real: Measures, simulated: Measures, effects: Mapping[str, Any]
) -> NoiseCurves:
    """Return the noise of a recording; `effects` has settings by effect in the simulation."""
    place = np.array([name for name in SURFACES for _ in range(AXES[name].bins)])
    middles, factors, level, count = {}, {}, {}, {}
    for field, covariate in FIELDS.items():
        mine = place == covariate
        edges = np.array(axes[covariate].edges)
        step = np.diff(edges)
        ends = edges[0] - step[0] / 2, edges[-1] + step[-1] / 2
        middles[field] = np.concatenate([ends[:1], (edges[1:] + edges[:-1]) / 2, ends[1:]])
        factors[field] = _factor(effects, field, middles[field])
        count[field] = real.noise[0][mine]
        with np.errstate(invalid='ignore'):  # No noise at all on both sides.
            ratio = (real.noise[1] - simulated.noise[1])[mine]
        some = np.minimum(count[field], simulated.noise[0][mine]) >= FORMS.known
        level[field] = np.where(some, ratio + 2 * np.log(factors[field]), np.nan)
    return NoiseCurves(middles, factors, level, count)


def _factor(effects: Mapping[str, Any], field: str, middles: np.ndarray) -> np.ndarray:
    # (B,) the factor on sigma_z that these effects have.
    if NAME not in effects:
        return np.ones(len(middles))
    (effect,) = parse_effects({NAME: effects[NAME]})
    if not effect.forms:
        return np.full(len(middles), effect.constants()['factor'])
    own = effect.forms.get(field)
    if own is None:
        return np.full(len(middles), np.nan)
    return np.asarray(1 + effect.strength * (own.at(middles) - 1), float)


def typical(field: str, noises: Sequence[NoiseCurves], places: np.ndarray) -> np.ndarray:
    """Return the mean factor of the simulations of recordings, at places along the covariate."""
    mean = np.mean([one.simulated[field] for one in noises], axis=0)
    return np.interp(places, noises[0].middles[field], mean)


def curve_of(field: str, noises: Sequence[NoiseCurves]) -> Curve:
    """Return the curve that is the mean of some recordings, for one of `FIELDS`."""
    mean, known = _mean(noises, field)
    if not known.any():
        return Curve((0.0,), (1.0,))
    knots, values = noises[0].middles[field][known], np.exp(mean[known] / 2)
    return Curve(
        tuple(float(x) for x in np.round(knots, 4)),
        tuple(float(y) for y in np.clip(np.round(values, 4), 0.1, 10.0)),
    )


def best_field(noises: Sequence[NoiseCurves]) -> str:
    """Return the field whose curve tells most of the noise of left-out recordings."""

    def told(field: str) -> float:
        # Of the square of ln variance about a constant, what the curve of the others takes off.
        total = 0.0
        for i, one in enumerate(noises):
            curve, known = _mean([*noises[:i], *noises[i + 1 :]], field)
            good = known & np.isfinite(one.level[field])
            if good.any():
                level, count = one.level[field][good], one.count[field][good]
                constant = np.average(curve[good], weights=count)
                gain = (level - constant) ** 2 - (level - curve[good]) ** 2
                total += float(np.average(gain, weights=count))
        return total

    known = [name for name in FIELDS if any(np.isfinite(one.level[name]).any() for one in noises)]
    return max(known or FIELDS, key=told)


def _mean(noises: Sequence[NoiseCurves], field: str) -> tuple[np.ndarray, np.ndarray]:
    # (B,) mean level by the number of pairs, and where there is one.
    levels = np.array([one.level[field] for one in noises])
    counts = np.where(np.isfinite(levels), [one.count[field] for one in noises], 0.0)
    number = counts.sum(axis=0)
    mean = (counts * np.nan_to_num(levels)).sum(axis=0) / np.maximum(number, 1)
    return mean, number > 0

"""
Whether recordings are alike, or some have an effect that others lack; and the mode that they tell.

They are not alike where a setting of the camera was changed midway, or where recordings are of two
cameras. For each effect the recordings are put on two sides: those that it brings nearer, and
those that it moves away, at the values that suit the first side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from flexx2_sim_ros.gap.calibration.inference import MODE, UNLIKE
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.features.features import LAYOUT
from flexx2_sim_ros.gap.inference.fitting import Fit, fit, losses_at
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.uncertainty import t_of
from flexx2_sim_ros.profiles.modes import Mode, Profile
import numpy as np

_ROWS = [
    i for i, one in enumerate(LAYOUT) if (one.channel, one.axis) == ('log_variance', 'distance')
]


@dataclass(frozen=True)
class Disagreement:
    """
    An effect that only some recordings have: `has` says of each whether it does.

    `gain` is the loss a recording that this takes off, beyond the same effect in all recordings.
    """

    effect: str
    has: tuple[bool, ...]
    gain: float

    def table(self, names: Sequence[str]) -> dict[str, Any]:
        """Return it as plain values, with the names of the recordings."""
        sides = list(zip(names, self.has, strict=True))
        has, lacks = ([name for name, here in sides if here == side] for side in (True, False))
        return {'name': self.effect, 'has': has, 'lacks': lacks, 'gain': round(self.gain, 1)}


def disagreement(
    model: Model, chosen: Fit, candidates: Sequence[Candidate]
) -> Disagreement | None:
    """
    Return the effect by which recordings disagree most clearly, beside those chosen.

    None if they do not disagree.
    """
    others: dict[str, Fit] = {}
    begun = []
    for candidate in candidates:
        name = candidate.effect
        if candidate.kind.role != 'pose':
            if name not in others:
                others[name] = _without(model, chosen, name)
            begun.append(_begin(model, others[name], candidate))
    best = _most_apart(begun)
    sides = [_sides(model, base, one, values, has) for base, one, values, has, _ in best]
    clear = [one for one in sides if one is not None and one.gain >= UNLIKE.gain]
    return max(clear, key=lambda one: one.gain, default=None)


_Begun = tuple[Fit, Candidate, np.ndarray, np.ndarray, float]


def _most_apart(begun: Sequence[_Begun]) -> list[_Begun]:
    # The best variant of those effects that move most recordings both ways.
    best: dict[str, _Begun] = {}
    for one in sorted(begun, key=lambda one: -one[-1]):
        best.setdefault(one[1].effect, one)
    return list(best.values())[: UNLIKE.tried]


def _without(model: Model, chosen: Fit, name: str) -> Fit:
    left = [(one, values) for one, values in chosen.parts if one.effect != name]
    if len(left) == len(chosen.candidates):
        return chosen
    start = np.array([value for _, values in left for value in values])
    return fit(model, [one for one, _ in left], start)


def _begin(model: Model, base: Fit, candidate: Candidate) -> _Begun:
    # The value that puts most on both sides, who has it, and how much is on the smaller side.
    neutral = np.array([term.neutral for term in candidate.terms])
    best = base, candidate, neutral, np.zeros(len(model.gap), bool), 0.0
    for i, term in enumerate(candidate.terms):
        for value, _ in term.nodes:
            values = neutral.copy()
            values[i] = value
            gain = base.loss - losses_at(model, _with(base, candidate, values))
            smaller = min(gain[gain > 0].sum(), -gain[gain < 0].sum())
            if smaller > best[-1]:
                best = base, candidate, values, gain > 0, float(smaller)
    return best


def _with(base: Fit, candidate: Candidate, values: np.ndarray) -> Fit:
    parts = (*base.candidates, candidate)
    return replace(base, candidates=parts, values=np.concatenate([base.values, values]))


def _sides(
    model: Model, base: Fit, candidate: Candidate, values: np.ndarray, has: np.ndarray
) -> Disagreement | None:
    parts, now = [*base.candidates, candidate], _with(base, candidate, values)
    for _ in range(UNLIKE.rounds):
        if not 2 <= has.sum() <= len(has) - 2:
            return None
        now = fit(model.only(candidate, has), parts, now.values)
        gain = base.loss - np.where(has, now.loss, losses_at(model, now))
        if ((gain > 0) == has).all():
            break
        has = gain > 0
    if np.abs(gain).min() < UNLIKE.each or ((gain > 0) != has).any():
        return None
    alike = min(base.total, fit(model, parts, now.values).total)
    return Disagreement(
        candidate.effect, tuple(has.tolist()), (alike - now.total) / len(model.gap)
    )


def likelier_mode(model: Model, told: Mode, profile: Profile) -> str:
    """
    Return the mode of a camera whose noise over distance recordings show; empty if it is `told`.

    A factor on the noise that is the same at all distances has other causes: the mode has to do
    better than the best of these.
    """
    edges = np.array(model.evidence[0].axes['distance'].edges)
    middles = np.sqrt(edges[1:] * edges[:-1])
    at = np.concatenate([edges[:1], middles, edges[-1:]])
    slant = math.radians(MODE.slant)

    def losses(shift: np.ndarray | float) -> np.ndarray:
        rest = model.gap[:, _ROWS] - shift
        loss = np.log1p(rest**2 / model.scale2[:, _ROWS]) * model.weights[:, _ROWS]
        return np.asarray(loss.sum(axis=1), float)

    usual = min((losses(factor) for factor in np.linspace(*MODE.factors)), key=np.sum)
    usual_sigma = told.noise.sigma_z(at, slant)
    found = '', 0.0
    for mode in profile.modes:
        if mode.noise_of == mode.name and mode.noise != told.noise:
            better = usual - losses(2 * np.log(mode.noise.sigma_z(at, slant) / usual_sigma))
            if better.mean() > max(found[1], MODE.gain) and t_of(better) > MODE.t:
                found = mode.name, float(better.mean())
    return found[0]

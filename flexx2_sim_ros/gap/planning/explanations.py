"""The explanations that a diagnosis leaves open, and how likely each one is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import Effect, of_role, registry
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.decidable import unseen
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.effects import fitted_effects
from flexx2_sim_ros.gap.inference.fitting import Fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.selection import Trials
from flexx2_sim_ros.gap.report.reading import Diagnosed
from flexx2_sim_ros.gap.report.text import spaced
import numpy as np

NONE = 'no effect'
_NARROWLY = 6.0  # loss: an effect that gains so much less is e^3 times less likely
Effects = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Explanation:
    """
    What may be the cause of a gap.

    Attributes
    ----------
    name : str
        For people.
    effects : dict
        Parameters by effect; empty if there is none.
    weight : float
        How likely it is.
    rest : numpy.ndarray
        (R, SIZE) what it leaves of the gap of the recordings, in units of the features' scale; NaN
        where there is none.

    """

    name: str
    effects: Effects
    weight: float
    rest: np.ndarray

    @property
    def cause(self) -> str | None:
        """Return the effect that a diagnosis should name first, None without effects."""
        return next(iter(self.effects), None)


def check_open(before: Diagnosed) -> None:
    """
    Check that a diagnosis leaves something open.

    Raises
    ------
    InputError
        When it does not, or lacks a key.

    """
    try:
        alternatives, hidden = before.table['alternatives'], before.table['not_decidable']
    except KeyError as error:
        raise InputError(
            f'DIAGNOSIS: diagnosis.json: must be as flexx2 gap diagnose writes it, got no '
            f'{shown(error.args[0])}'
        ) from error
    if before.verdict == 'identified' and not (alternatives or hidden):
        raise InputError('DIAGNOSIS: must leave something open, got one explanation: check it')
    if not (before.table.get('effects') or alternatives or hidden):
        raise InputError(
            'DIAGNOSIS: must have alternatives or effects that are not decidable, got verdict '
            f'{shown(before.verdict)} without any'
        )


def explanations(
    model: Model, decision: Decision, candidates: Sequence[Candidate]
) -> list[Explanation]:
    """
    Return the sets of effects that are still possible.

    These are the chosen effects, each alternative (which replaces some of them), each single
    effect that was rejected narrowly, each effect that the ground truth cannot decide (at typical
    strength), and no effect. If no gap was found, each effect that would not make one in these
    recordings is possible, too. Pose errors count as no effect. An explanation is as likely as
    exp(gain / 2), with the gain in loss of a `Choice`.

    Parameters
    ----------
    model : Model
        The recordings.
    decision : Decision
        What the diagnosis says about them.
    candidates : sequence of Candidate
        The catalogue.

    """
    trials = Trials(model)
    sets = [*_found(trials, decision), *_narrowly_rejected(model, decision)]
    base, kept = decision.accepted, _table(fitted_effects(model, decision.accepted))
    gain = _gain(trials, base)
    hidden = [one.effect for one in decision.undecided]
    if not decision.finds_gap:
        hidden += [name for name in unseen(model, candidates) if name not in hidden]
    sets += [(kept | {name: registry()[name]().settings}, gain, base) for name in hidden]
    sets.append(({}, 0.0, decision.base))
    pose, out = of_role('pose').name, dict[str, tuple[Effects, float, Fit]]()
    for effects, gain, fit in sets:
        # The pose of each recording is fitted in any case, so a pose error looks like no effect.
        camera = {name: values for name, values in effects.items() if name != pose}
        if not any(camera == other for other, *_ in out.values()):
            out.setdefault(' + '.join(map(spaced, camera)) or NONE, (camera, gain, fit))
    gains = np.array([gain for _, gain, _ in out.values()])
    weights = np.exp((gains - gains.max()) / 2)
    weights /= weights.sum()
    return [
        Explanation(name, effects, weight, _rest(model, fit))
        for (name, (effects, _, fit)), weight in zip(out.items(), weights, strict=True)
    ]


def _rest(model: Model, fit: Fit) -> np.ndarray:
    return np.where(model.good, fit.residual(model) / np.sqrt(model.scale2), np.nan)


def _found(trials: Trials, decision: Decision) -> list[tuple[Effects, float, Fit]]:
    # The chosen effects and the alternatives.
    fits = [decision.chosen] if decision.explains_gap else []
    if decision.finds_gap:
        fits += [one.fit for one in decision.alternatives]
    return [(_table(fitted_effects(trials.model, fit)), _gain(trials, fit), fit) for fit in fits]


def _narrowly_rejected(model: Model, decision: Decision) -> list[tuple[Effects, float, Fit]]:
    # Single effects are compared with each other, not with a set of effects.
    if not decision.finds_gap or len(decision.accepted.candidates) > 1:
        return []
    best = decision.considered[0].gain
    known = {decision.accepted.candidates[0].effect} if decision.accepted.candidates else set()
    known |= {one.fit.candidates[-1].effect for one in decision.alternatives}
    return [
        (_table(fitted_effects(model, one.fit)), one.gain, one.fit)
        for one in decision.considered
        if one.gain > max(best - _NARROWLY, 0) and one.fit.candidates[0].effect not in known
    ]


def _gain(trials: Trials, fit: Fit) -> float:
    return trials.choice(fit.candidates, fit.values).gain if fit.candidates else 0.0


def _table(effects: Iterable[Effect]) -> Effects:
    return {effect.name: dict(effect.settings) for effect in effects}

"""What a diagnosis decided, fitted around the simulation that has it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from flexx2_sim_ros.effects import Effect, parse_effects
from flexx2_sim_ros.gap.inference.decide import Decision, with_effects
from flexx2_sim_ros.gap.inference.effects import fitted_effects, held_out_effects
from flexx2_sim_ros.gap.inference.joint import Table
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.rounds import Campaign, explain
import numpy as np


@dataclass(frozen=True)
class FoundSet:
    """
    What was decided, with the effects as they are simulated.

    * `fitted`, `held_out`: fitted to all recordings, and without each recording.
    * `motions`: where the camera of each recording is with them.
    * `sigma`: relative error of the base sigma_z.
    """

    decision: Decision
    fitted: list[Effect]
    held_out: list[list[Effect]]
    motions: list[np.ndarray]
    sigma: float


def found_set(decision: Decision, model: Model) -> FoundSet:
    """Return what was decided, as it was fitted around the simulation without effects."""
    fit = decision.accepted
    motions = model.own.found(fit.nuisances)
    fitted, held_out = fitted_effects(model, fit), held_out_effects(model, fit)
    return FoundSet(decision, fitted, held_out, motions, fit.sigma)


def explained(decision: Decision, model: Model, campaign: Campaign) -> FoundSet:
    """
    Fit what was decided around the simulation that has it.

    It was decided around the simulation without effects, and `model` has the recordings beside
    that; `campaign` has the same recordings, to be simulated.
    """
    before = found_set(decision, model)
    posed = [one for one in decision.accepted.candidates if one.kind.role == 'pose']
    chosen = [one for one in decision.accepted.candidates if one.kind.role != 'pose']
    if len(chosen) < 2 or len(campaign.found) == 1:
        # As decided: what else is seen of one cause may be its form, and one recording has no
        # other that says what is needed.
        return before
    undecided = {one.effect for one in decision.undecided} - {one.effect for one in chosen}
    left = [one for one in campaign.candidates if one.effect not in undecided]
    one = explain(replace(campaign, candidates=left), model, decision.accepted.parts)
    if not one.effects:
        return before
    forms = [*(one.forms[name] for name in one.effects), *posed]
    values = [
        one.effects[form.effect].get(term.name, term.neutral)
        for form in forms
        for term in form.terms
    ]
    decision = with_effects(decision, model, forms, np.array(values, float))
    typical = found_set(decision, model)

    def own(table: Table, as_fitted: Sequence[Effect]) -> list[Effect]:
        # A form is fitted again, beside all of the set: it begins as in the catalogue.
        now = {effect.name: effect for effect in parse_effects(table) if not effect.forms}
        return [now.get(effect.name, effect) for effect in as_fitted]

    return replace(
        typical,
        fitted=own(one.effects, typical.fitted),
        held_out=[own(*pair) for pair in zip(one.without, typical.held_out, strict=True)],
        motions=one.motions,
        sigma=one.sigma,
    )

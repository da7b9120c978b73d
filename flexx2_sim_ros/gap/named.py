"""What a diagnosis names, and what simulating it gives."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexx2_sim_ros.effects import Effect, parse_effects
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.features.confirm import apart, confirm, measured_parts, Outcome
from flexx2_sim_ros.gap.features.processed import process_both, Processed
from flexx2_sim_ros.gap.features.work import (
    at_pose,
    jobs_at,
    noisier,
    Progress,
    Simulator,
    stepper,
)
from flexx2_sim_ros.gap.forms.calibrating import calibrate_named, Calibrated
from flexx2_sim_ros.gap.forms.looked import confirm_settled, Settings
from flexx2_sim_ros.gap.forms.proposals import rounds
from flexx2_sim_ros.gap.inference.decide import Decision, with_effects
from flexx2_sim_ros.gap.inference.effects import (
    fitted_effects,
    held_out_effects,
    of_camera,
    table_of,
)
from flexx2_sim_ros.gap.inference.improvement import all_measured, remaining, taken_off
from flexx2_sim_ros.gap.inference.jackknife import as_wrong_as_fitted
from flexx2_sim_ros.gap.inference.joint import Table
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report.frames import MOST_FRAMES
from flexx2_sim_ros.gap.report.table import calibrated_table, diagnosis_table, verdict_of
from flexx2_sim_ros.gap.rounds import as_searched, Campaign, explain
from flexx2_sim_ros.processing import Chain
from flexx2_sim_ros.recording.reader import PROCESSED
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
    several = len(chosen) > 1 or len(as_searched(campaign.candidates)) > 1
    if not chosen or not several or len(campaign.found) == 1:
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

    fitted = own(one.effects, typical.fitted)
    held_out = [own(*pair) for pair in zip(one.without, typical.held_out, strict=True)]
    return FoundSet(decision, fitted, held_out, one.motions, one.sigma)


@dataclass(frozen=True)
class Named:
    """
    What is named, and what simulating it gives.

    * `effects`: those that were found, with curves, tables and maps (`forms`) if any were fitted.
    * `first`, `confirmed`: of each recording, simulated with what was found without it; with
      `forms` where those are taken.
    * `motions`, `own`: of each recording in `confirmed`, where the camera was, and the effects.
    * `used`, `simulator`: the recordings at the noise level of the decision, and what simulates
      them.
    * `bare`: where each one is without effects, as for `confirm.confirm`.
    * `parts`: (R, 4) what each effect takes off each recording, as from `confirm.parts`.
    """

    found: FoundSet
    effects: list[Effect]
    first: list[Outcome]
    forms: Calibrated | None
    confirmed: list[Outcome]
    motions: list[np.ndarray]
    used: list[Found]
    simulator: Simulator
    own: list[Settings]
    bare: list[np.ndarray | None]
    parts: dict[str, np.ndarray] = field(default_factory=dict)

    def table(
        self, model: Model, used: list[Found], left_out: list[tuple[str, str]]
    ) -> dict[str, Any]:
        """Return the table of the diagnosis, as far as it is about the named effects."""
        decision, fitted = self.found.decision, self.found.fitted
        out = diagnosis_table(model, decision, fitted, self.first, used, left_out, self.parts)
        if self.forms is not None:
            out = calibrated_table(out, model, decision, self.forms, self.confirmed, self.motions)
        out['verdict'] = verdict_of(out)
        for i, own in enumerate(self.found.held_out):  # Used recordings are first.
            here = {name: float(part[i, 0]) for name, part in self.parts.items()}
            out['recordings'][i] |= {'effects_without': table_of(own), 'takes_off_here': here}
        return out


def simulate_named(
    model: Model,
    found: FoundSet,
    used: list[Found],
    simulator: Simulator,
    which: str,
    progress: Progress,
) -> Named:
    """
    Simulate the recordings with the effects that were found, fit their forms, measure their parts.

    `used` are the files of the recordings; `which` are the forms to fit, as for `diagnose`.
    """
    named = _with_forms(model, found, used, simulator, which, progress)
    there = [one.apart for one in named.confirmed]
    jobs = jobs_at(named.used, named.motions, effects=named.own, known=there)
    step = stepper(progress, 'switching effects on one by one', 0.96, 0.02, len(jobs))
    parts = named.simulator.run(at_pose, jobs, step, look=measured_parts) if any(named.own) else []
    return replace(named, parts=_in_order(parts))


def _in_order(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    # (R, 4) of each effect, the largest first.
    each = {name: np.array([one[name] for one in parts]) for some in parts[:1] for name in some}
    return dict(sorted(each.items(), key=lambda pair: -pair[1][:, 0].mean()))


def _with_forms(
    model: Model,
    found: FoundSet,
    used: list[Found],
    simulator: Simulator,
    which: str,
    progress: Progress,
) -> Named:
    motions, fitted, held_out = found.motions, found.fitted, found.held_out
    used, noisy = noisier(used, simulator.profile, 1 + found.sigma)
    simulator = replace(simulator, profile=noisy)
    step = stepper(progress, 'simulating the outcome', 0.8, 0.06, 2 * len(used))
    # Frames are shown of the recordings with the largest gap.
    largest = np.argsort(-found.decision.base.loss, kind='stable')[:MOST_FRAMES].tolist()
    show = [i in largest for i in range(len(used))]
    without = [of_camera(one) for one in held_out]
    wrong = as_wrong_as_fitted(of_camera(fitted), without)
    bare = model.own.free_planes_at(found.decision.base.nuisances)

    poses = _poses_elsewhere(model, fitted, motions)
    # At other poses, `_elsewhere` simulates the wrong effects, and not this.
    here = wrong if poses is None else without
    jobs = jobs_at(used, motions, effects=without, wrong=here, show=show, bare=bare)
    named = Named(found, fitted, [], None, [], motions, used, simulator, without, bare)
    first = simulator.run(at_pose, jobs, step, look=confirm)
    first = _elsewhere(named, first, poses, wrong, step)
    named = replace(named, first=first, confirmed=first)
    if which == 'catalogue':
        return named
    quick = which == 'quick'
    total = (2 + rounds(of_camera(fitted), quick)) * len(used)
    step = stepper(progress, 'fitting curves and maps', 0.86, 0.1, total)
    forms = calibrate_named(used, motions, fitted, held_out, simulator, step, quick)
    if forms is None:
        return named
    effects = forms.effects(fitted)
    named = replace(named, effects=effects, forms=forms)
    if not forms.taken:
        return named
    now = list(forms.explained.now)
    wrong = as_wrong_as_fitted(forms.explained.effects, now)
    # Each recording with forms that were not fitted to it.
    each = list(zip(forms.explained.looked, now, wrong, show, bare, strict=True))
    both = simulator.run(confirm_settled, each, step)
    confirmed, motions = [one for one, _ in both], [motion for _, motion in both]
    poses = _poses_elsewhere(model, effects, motions)
    confirmed = _elsewhere(named, confirmed, poses, wrong, step)
    return replace(named, confirmed=confirmed, motions=motions, own=now)


def _elsewhere(
    named: Named,
    outcomes: list[Outcome],
    poses: Sequence[np.ndarray] | None,
    wrong: Sequence[Settings],
    step: Callable[[], None],
) -> list[Outcome]:
    # Outcomes with how far recordings and simulations are apart at the poses of other scenes, with
    # effects that are as wrong as their fit leaves open.
    if poses is None or not any(wrong):
        return outcomes
    jobs = jobs_at(named.used, poses, effects=wrong, bare=named.bare)
    found = named.simulator.run(at_pose, jobs, step, look=apart)
    return [replace(one, elsewhere=far) for one, far in zip(outcomes, found, strict=True)]


def _poses_elsewhere(
    model: Model, effects: Sequence[Effect], motions: Sequence[np.ndarray]
) -> list[np.ndarray] | None:
    # Those of other scenes of the same camera, whose poses have other errors, or None if they are
    # the fitted ones. They are, if poses can hide no part of the effects, such as random dropout.
    # What the poses have in common then is chance, or another cause that is not named.
    posed = any(one.role == 'pose' for one in effects)
    if not posed and not any('pose' in one.nuisances for one in effects):
        return None
    poses = model.own.elsewhere(motions, posed)
    same = all(np.array_equal(*pair) for pair in zip(poses, motions, strict=True))
    return None if same else poses


def processed_table(
    chain: Chain, model: Model, named: Named, step: Callable[[], None]
) -> dict[str, Any]:
    """
    Process recordings and their simulations, and measure what is left of the gap.

    The result is ``processed`` of ``docs/diagnosis.md``. Only stages in metres of what the robot's
    program does to depth, `chain`, are measured. `step` is called after each recording.
    """
    stages = chain.in_metres()
    if any(PROCESSED in note for file in named.used for note in file.notes):
        return {'reason': 'the recordings are processed already, and diagnosed as they are'}
    used, same = named.used, [stages] * len(named.used)
    jobs = jobs_at(used, named.motions, effects=named.own, bare=named.bare, stages=same)
    found = named.simulator.run(at_pose, jobs, step, look=process_both)
    good = [one for one in found if isinstance(one, Processed)]
    if len(good) < len(found):
        return {'reason': next(one for one in found if isinstance(one, str))}
    here, parts = [one.apart for one in good], _in_order([one.parts for one in good])
    return {
        'stages': [one.name for one in stages],
        'not_measured': [one.name for one in chain.stages[len(stages) :]],
        **all_measured(model, here),
        **remaining(here, here),
        'effects': {name: taken_off(part) for name, part in parts.items()},
    }

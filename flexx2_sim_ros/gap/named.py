"""What a diagnosis names, and what simulating it gives."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.explained import FoundSet
from flexx2_sim_ros.gap.features.confirm import apart, confirm, measured_parts, Outcome
from flexx2_sim_ros.gap.features.processed import process_both_or_why, Processed
from flexx2_sim_ros.gap.forms.calibrating import calibrate_named, Calibrated
from flexx2_sim_ros.gap.forms.looked import confirm_settled, Settings, Simulator
from flexx2_sim_ros.gap.forms.proposals import rounds
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.effects import of_camera, table_of
from flexx2_sim_ros.gap.inference.improvement import all_measured, remaining, taken_off
from flexx2_sim_ros.gap.inference.jackknife import as_wrong_as_fitted
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report.frames import MOST_FRAMES
from flexx2_sim_ros.gap.report.table import calibrated_table, diagnosis_table, verdict_of
from flexx2_sim_ros.gap.work import at_pose, jobs_at, noisier, Progress, stepper
from flexx2_sim_ros.processing import Chain
from flexx2_sim_ros.recording.reader import PROCESSED
import numpy as np


@dataclass(frozen=True)
class Named:
    """
    What is named, and what simulating it gives.

    * `found`: as found by the decision.
    * `effects`: the same, with curves, tables and maps where those were fitted.
    * `first`: of each recording, with what was found without it.
    * `forms`: the curves, tables and maps.
    * `confirmed`: of each recording, with `forms` where those are taken.
    * `motions`: where the camera of each recording was in `confirmed`.
    * `used`: the recordings, at the noise level of the decision.
    * `simulator`: of these.
    * `own`: of each recording, the effects of the camera in `confirmed`: parameters by name.
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

    @property
    def decision(self) -> Decision:
        """Return what was decided."""
        return self.found.decision

    def table(
        self, model: Model, used: list[Found], left_out: list[tuple[str, str]]
    ) -> dict[str, Any]:
        """Return the table of the diagnosis, as far as it is about the named effects."""
        one, parts = self.found, self.parts
        out = diagnosis_table(model, one.decision, one.fitted, self.first, used, left_out, parts)
        if self.forms is not None:
            out = calibrated_table(
                out, model, one.decision, self.forms, self.confirmed, self.motions
            )
        out['verdict'] = verdict_of(out)
        for i, own in enumerate(one.held_out):  # Used recordings are first.
            row = out['recordings'][i]
            row['effects_without'] = table_of(own)
            row['takes_off_here'] = {name: float(part[i, 0]) for name, part in parts.items()}
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
    show = _shown(found.decision)
    without = [of_camera(one) for one in held_out]
    wrong = as_wrong_as_fitted(of_camera(fitted), without)
    bare = model.own.free_planes_at(found.decision.base.nuisances)
    elsewhere = _Elsewhere(model, used, simulator, bare)
    poses = elsewhere.poses(fitted, motions)
    # At other poses, `measured` simulates the wrong effects, and not this.
    here = wrong if poses is None else without
    jobs = jobs_at(used, motions, effects=without, wrong=here, show=show, bare=bare)
    first = simulator.run(at_pose, jobs, step, look=confirm)
    first = elsewhere.measured(first, poses, wrong, step)
    rest = used, simulator, without, bare
    plain_ones = Named(found, fitted, first, None, first, motions, *rest)
    if which == 'catalogue':
        return plain_ones
    quick = which == 'quick'
    total = (2 + rounds(of_camera(fitted), quick)) * len(used)
    step = stepper(progress, 'fitting curves and maps', 0.86, 0.1, total)
    forms = calibrate_named(used, motions, fitted, held_out, simulator, step, quick)
    if forms is None:
        return plain_ones
    effects = forms.effects(fitted)
    named = replace(plain_ones, effects=effects, forms=forms)
    if not forms.taken:
        return named
    formed = forms.explained
    now = list(formed.now)
    wrong = as_wrong_as_fitted(formed.effects, now)
    # Each recording with forms that were not fitted to it.
    each = list(zip(formed.looked, now, wrong, show, bare, strict=True))
    both = simulator.run(confirm_settled, each, step)
    confirmed, motions = [one for one, _ in both], [motion for _, motion in both]
    poses = elsewhere.poses(effects, motions)
    confirmed = elsewhere.measured(confirmed, poses, wrong, step)
    return replace(named, confirmed=confirmed, motions=motions, own=now)


@dataclass(frozen=True)
class _Elsewhere:
    # The gap as it is in other scenes of the same camera, whose poses have other errors.
    model: Model
    used: Sequence[Found]
    simulator: Simulator
    bare: Sequence[np.ndarray | None]

    def poses(
        self, effects: Sequence[Effect], motions: Sequence[np.ndarray]
    ) -> list[np.ndarray] | None:
        # Those of other scenes, or None if they are the fitted ones. They are, if poses can hide
        # no part of the effects, such as random dropout. What the poses have in common then is
        # chance, or another cause that is not named.
        posed = any(one.role == 'pose' for one in effects)
        if not posed and not any('pose' in one.nuisances for one in effects):
            return None
        poses = self.model.own.elsewhere(motions, posed)
        same = all(np.array_equal(*pair) for pair in zip(poses, motions, strict=True))
        return None if same else poses

    def measured(
        self,
        outcomes: Sequence[Outcome],
        poses: Sequence[np.ndarray] | None,
        wrong: Sequence[Settings],
        step: Callable[[], None],
    ) -> list[Outcome]:
        # Outcomes with how far recordings and simulations are apart there, with effects that are
        # as wrong as their fit leaves open.
        if poses is None or not any(wrong):
            return list(outcomes)
        jobs = jobs_at(self.used, poses, effects=wrong, bare=self.bare)
        found = self.simulator.run(at_pose, jobs, step, look=apart)
        return [replace(one, elsewhere=far) for one, far in zip(outcomes, found, strict=True)]


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
    found = named.simulator.run(at_pose, jobs, step, look=process_both_or_why)
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


def _shown(decision: Decision) -> list[bool]:
    # Frames are shown of the recordings with the largest gap.
    loss = decision.base.loss
    largest = set(np.argsort(-loss, kind='stable')[:MOST_FRAMES].tolist())
    return [i in largest for i in range(len(loss))]

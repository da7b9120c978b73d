"""Diagnose a campaign: where the gap lies, what causes it, and how far the effects reduce it."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
import resource
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import check_outputs
from flexx2_sim_ros.camera import flexx2, Profile
from flexx2_sim_ros.effects import Effect, of_role, parse_effects, registry
from flexx2_sim_ros.effects.patch import ResidualPatch
from flexx2_sim_ros.effects.registry import check_map_files
from flexx2_sim_ros.effects.tables import plain
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.cost import CostRequest, found_consumers, known_of, measure_cost
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.given import given_effects, Table
from flexx2_sim_ros.gap.data.hidden import hidden_effects, Undecided
from flexx2_sim_ros.gap.data.prior import prior_from_scatter, USUAL
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue
from flexx2_sim_ros.gap.features.confirm import confirm
from flexx2_sim_ros.gap.features.work import (
    at_pose,
    find,
    jobs_at,
    portion,
    Progress,
    search_inside,
    Simulator,
    stepper,
    summarise_all,
)
from flexx2_sim_ros.gap.inference.decidable import decidable_candidates
from flexx2_sim_ros.gap.inference.decide import decide, Decision
from flexx2_sim_ros.gap.inference.disagreement import disagreement, likelier_mode
from flexx2_sim_ros.gap.inference.effects import of_camera, table_of
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.patch import fit_patch
from flexx2_sim_ros.gap.named import explained, found_set, Named, processed_table, simulate_named
from flexx2_sim_ros.gap.report.reading import diagnosed
from flexx2_sim_ros.gap.report.table import makes_larger, patch_table
from flexx2_sim_ros.gap.report.writing import FILES, write
from flexx2_sim_ros.gap.rounds import Campaign
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.limits import check_whole
from flexx2_sim_ros.physics.frame_state import why_no_phases
from flexx2_sim_ros.processing import Chain
import numpy as np

_FORMS = 'catalogue', 'quick', 'all'
_BEFORE_COST, _ROUNDS = 0.6, 6  # on the progress bar: part of the work, jobs of a recording


def diagnose(
    campaign_dir: str | Path,
    *,
    profile: Profile | None = None,
    without: Collection[str] = (),
    seed: int = 0,
    jobs: int = 1,
    out: str | Path | None = None,
    pose_prior: tuple[float, float] | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
    known: Table | None = None,
    cost: bool = False,
    forms: str = 'quick',
    process: Chain | None = None,
) -> dict[str, Any]:
    """
    Diagnose the gap between recordings and the simulation of their scenes.

    Parameters
    ----------
    campaign_dir : str or pathlib.Path
        A folder of recordings (``.npz`` or bags) with ``clean_depth``, one scene each.
    profile : Profile, optional
        The camera (default: the Flexx2).
    without : collection of str
        Effects to leave out of the catalogue.
    seed : int
        Seed of the simulations; the same input and seed give the same result.
    jobs : int
        Number of processes.
    out : str or pathlib.Path, optional
        Folder to write ``diagnosis.json``, ``effects.yaml`` and ``report.html`` to.
    pose_prior : tuple of float, optional
        Standard deviations of the errors of the given poses, metres and degrees. They hold the
        poses. Left out, poses may be as wrong as they seem; where several effects are found, they
        are held by how much they scatter.
    progress : callable, optional
        Called with the name of the current step and the fraction of the work that is done.
    scheduler : str, optional
        Address of a Dask scheduler to work on.
    known : mapping, optional
        Effects taken as given, parameters by name: the base simulator has them, and the diagnosis
        looks for others.
    cost : bool
        Whether to measure what the gap costs as well, as `flexx2_sim_ros.gap.cost` does with all
        installed consumers. A script that asks for this needs ``if __name__ == '__main__':``.
    forms : str
        Which curves, tables, maps and numbers of the named effects are fitted: ``catalogue``,
        none; ``quick``, those that need few simulations; ``all``.
    process : Chain, optional
        What the robot's program does to depth: what is left of the gap after it is measured.

    Returns
    -------
    dict
        The table that ``docs/diagnosis.md`` describes.

    Raises
    ------
    InputError
        When no recording can be used or an argument is wrong; then nothing is written.

    """
    began = time.monotonic()
    usual = pose_prior or USUAL
    _check(without, seed, jobs, usual, forms)
    told = table_of(parse_effects(known or {}, 'known'))
    known = table_of(given_effects(known or {}))
    whole = progress or (lambda text, fraction: None)
    progress = portion(whole, 0.0, _BEFORE_COST) if cost else whole
    request = CostRequest(*found_consumers(()), jobs) if cost else None
    if out is not None:
        check_outputs('--out', out, FILES)
        check_map_files(out)
    if scheduler is not None:
        campaign_dir = Path(campaign_dir).absolute()  # Workers run in other folders.
    progress('looking for recordings', 0.0)
    prior = np.array([usual[0]] * 3 + [usual[1]] * 3)
    with workers(jobs, scheduler) as mapped:
        found, left_out = find(campaign_dir, profile, mapped)
        no_phases = why_no_phases(found[0].mode)
        left = {*without, *known}
        step = stepper(progress, 'looking into the camera', 0.01, 0.04, len(found))
        simulator = Simulator(mapped, profile, known, seed, tuple(prior))
        inside = search_inside(found, simulator, step)
        columns, candidates = catalogue(left, not no_phases, inside)
        hidden = [one for one in hidden_effects(campaign_dir) if one.effect not in left]
        text = 'simulating what could explain the recordings'
        step = stepper(progress, text, 0.05, 0.35, len(found))
        simulator = replace(simulator, columns=columns, inside=inside)
        used, evidence, unusable = summarise_all(campaign_dir, found, left_out, simulator, step)
        model = Model(evidence, columns, prior, held=pose_prior is not None)
        decision = _decide(model, candidates, hidden, progress)
        left_out = left_out + unusable
        scatter = _scatter(model, decision)
        if scatter is not None:
            still = portion(progress, 0.5, 0.0)
            step = stepper(still, 'simulating at poses as they scatter', 0.0, 0.0, len(used))
            simulator = replace(simulator, prior=tuple(scatter))
            _, evidence, _ = summarise_all(campaign_dir, used, [], simulator, step)
            model = Model(evidence, columns, scatter, held=True)
            candidates = [one for one in candidates if one.kind.role != 'pose']
            decision = _decide(model, candidates, hidden, still)
        step = stepper(progress, 'fitting effects together', 0.5, 0.3, _ROUNDS * len(used))
        recorded = str(campaign_dir), used, candidates
        campaign = Campaign(*recorded, simulator, model.own, step, held=model.held)
        chosen = explained(decision, model, campaign)
        named = simulate_named(model, chosen, used, simulator, forms, progress)
        table = named.table(model, used, left_out)
        if makes_larger(table):
            refused, still = named.found.decision.refused(), portion(progress, 0.98, 0.0)
            chosen = found_set(refused, model)
            named = simulate_named(model, chosen, used, simulator, forms, still)
            table = named.table(model, used, left_out)
        effects, decision = named.effects, named.found.decision
        table['settings'] = _settings(found[0], seed, model, pose_prior is not None, told)
        poses = '' if model.own.posed.any() else 'the ground truth gives all poses as exact'
        if scatter is not None:
            poses = 'the poses are held by how much they scatter'
        table['likelier_mode'] = likelier_mode(model, found[0].mode, profile or flexx2())
        table['not_considered'] = _not_considered(without, known, no_phases, poses, hidden)
        if decision.verdict == 'unknown' and ResidualPatch.name not in known:
            step = stepper(progress, 'simulating the correction', 0.96, 0.02, len(used))
            effects, table['patch'] = _correction(model, named, step)
        if process is not None:
            step = stepper(progress, 'processing both sides', 0.96, 0.02, len(used))
            table['processed'] = processed_table(process, model, named, step)
        if request is not None:
            later = portion(whole, _BEFORE_COST, 0.98 - _BEFORE_COST)
            table['cost'] = _cost(request, table, effects, campaign_dir, used, simulator, later)
    whole('writing', 0.98)
    table.update(_costs(began, min(jobs - 1, len(found))))
    if out is not None:
        write(Path(out), table, effects, model, decision, named.confirmed, named.forms)
    whole('done', 1.0)
    return table


def _settings(found: Found, seed: int, model: Model, stated: bool, known: Table) -> dict[str, Any]:
    return {
        'usecase': found.mode.name,
        'full_scale': found.full_scale,
        'seed': seed,
        'pose_prior': [float(one) for one in model.prior[::3]],
        'pose_held': model.held,
        'pose_stated': stated,
        'known': {name: plain(values) for name, values in known.items()},
    }


def _check(
    without: Collection[str], seed: int, jobs: int, pose_prior: tuple[float, float], forms: str
) -> None:
    for name in without:
        if name not in registry():
            raise InputError(f'without: must be among {", ".join(registry())}, got {name}')
    check_whole('seed', seed, 0)
    check_whole('jobs', jobs, 1)
    if forms not in _FORMS:
        raise InputError(f'forms: must be {", ".join(_FORMS)}, got {shown(forms)}')
    if len(pose_prior) != 2 or not all(0 < value < 1e3 for value in pose_prior):
        raise InputError(f'pose_prior: must be metres and degrees above 0, got {pose_prior!r}')


def _decide(
    model: Model, candidates: list[Candidate], hidden: list[Undecided], progress: Progress
) -> Decision:
    some, absorbed = decidable_candidates(model, candidates, hidden)
    step = stepper(progress, 'comparing explanations', 0.4, 0.1, 2 * len(some))
    decision = decide(model, some, step, absorbed=absorbed)
    if not model.seen.any():
        return replace(decision, verdict='none')  # The table says `too_little`.
    return replace(decision, unlike=disagreement(model, decision.accepted, candidates))


def _scatter(model: Model, decision: Decision) -> np.ndarray | None:
    # The prior of poses of which nothing is stated, if several effects are named: poses that may
    # be wrong by any amount hide a part of them. Then their scatter is no finding.
    roles = [one.kind.role for one in decision.accepted.candidates]
    sure = [one.sure_pose for one in model.evidence if one.covariance is None]
    several = len(roles) > 1 and 'pose' not in roles
    if model.held or not several or len(sure) < GROUND_TRUTH.fewest_poses:
        return None
    return prior_from_scatter(np.array(sure))


def _correction(
    model: Model, named: Named, step: Callable[[], None]
) -> tuple[list[Effect], dict[str, Any]]:
    # The correction without a cause, or nothing if it does not help; and what it does.
    used = named.used
    patch = fit_patch(model, named.found.decision.base.residual(model))
    without = [of_camera([one]) for one in patch.without]
    motions = model.own.found(named.found.decision.accepted.nuisances)
    jobs = jobs_at(used, motions, effects=without, wrong=without)
    patched = named.simulator.run(at_pose, jobs, step, look=confirm)
    table = patch_table(patch, model, patched)
    return [patch.effect] if table['offered'] else [], table


def _cost(
    request: CostRequest,
    table: dict[str, Any],
    effects: Sequence[Effect],
    campaign: str | Path,
    used: Sequence[Found],
    simulator: Simulator,
    progress: Progress,
) -> dict[str, Any]:
    # The table of `gap.cost`, or the reason why there is none.
    if all(one.role == 'pose' for one in effects):
        return {'reason': 'no effect that changes images is named'}
    known = known_of(diagnosed(table, effects))
    try:
        return measure_cost(request, known, campaign, used, (), simulator, progress)[0]
    except InputError as error:
        return {'reason': str(error)}


def _not_considered(
    without: Collection[str],
    known: Collection[str],
    no_phases: str,
    poses: str,
    hidden: Collection[Undecided],
) -> list[dict[str, str]]:
    # Effects of the registry that are not in the catalogue, and why.
    reasons = {
        name: no_phases for name, kind in registry().items() if kind.needs_modulation and no_phases
    }
    pose = of_role('pose').name
    reasons.update({one.effect: one.reason for one in hidden if one.effect == pose})
    if poses:
        reasons[pose] = poses
    reasons.update(dict.fromkeys(without, 'left out as asked for'))
    reasons.update(dict.fromkeys(known, 'taken as given'))
    return [{'name': name, 'reason': reasons[name]} for name in registry() if name in reasons]


def _costs(began: float, children: int) -> dict[str, Any]:
    # What it took. Only the largest child process is known; all need about the same memory.
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return {
        'seconds': round(time.monotonic() - began, 2),
        'peak_mb': round((own + children * largest) / 1024, 1),
        'version': __version__,
    }

"""Diagnose a campaign: where the gap lies, what causes it, how far it shrinks."""

from collections.abc import Callable, Collection
from dataclasses import asdict, replace
from pathlib import Path
import resource
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import Effect, of_role, registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.calibration.constants import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import Found, nothing_left
from flexx2_sim_ros.gap.data.pose import NAMES
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import ENOUGH, Feature, LAYOUT
from flexx2_sim_ros.gap.features.physical import UNITS
from flexx2_sim_ros.gap.inference.decide import Alternative, decide, Decision
from flexx2_sim_ros.gap.inference.fitting import Fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.patch import fit_patch
from flexx2_sim_ros.gap.inference.uncertainty import ratio_interval
from flexx2_sim_ros.gap.inference.where import places, unexplained
from flexx2_sim_ros.gap.work import find, simulate_set, summarise
from flexx2_sim_ros.jobs import bind, workers
from flexx2_sim_ros.physics.frame_state import why_no_phases
import numpy as np

Progress = Callable[[str, float], None]
SCHEMA = 1


def diagnose(
    campaign_dir: str | Path,
    *,
    profile: Profile | None = None,
    without: Collection[str] = (),
    seed: int = 0,
    jobs: int = 1,
    out: str | Path | None = None,
    pose_prior: tuple[float, float] = (0.010, 0.5),
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """
    Diagnose the gap between recordings and the simulation of their scenes.

    Parameters
    ----------
    campaign_dir : str or pathlib.Path
        A folder of recordings (``.npz`` or bags) with ``clean_depth``, one scene each.
    profile : Profile, optional
        The camera; the Flexx2 when left out.
    without : collection of str
        Effects to leave out of the catalogue.
    seed : int
        Of the simulations; the same input and seed give the same outcome.
    jobs : int
        Processes.
    out : str or pathlib.Path, optional
        Folder to write ``diagnosis.json``, ``effects.yaml`` and ``report.html`` to.
    pose_prior : tuple of float
        How wrong a recording's pose usually is: standard deviations in metres and degrees.
    progress : callable, optional
        Called with what is being done, and the share that is done.
    scheduler : str, optional
        Address of a Dask scheduler to work on.

    Returns
    -------
    dict
        As in ``docs/diagnosis.md``.

    Raises
    ------
    InputError
        When no recording can be used or an argument is wrong; nothing is written then.

    """
    began = time.monotonic()
    _check(without, seed, jobs, pose_prior)
    progress = progress or (lambda text, share: None)
    if out is not None:
        from flexx2_sim_ros.gap.report.writing import check_folder, write

        check_folder(Path(out))
    progress('looking for recordings', 0.0)
    prior = np.array([pose_prior[0]] * 3 + [pose_prior[1]] * 3)
    done = 0

    def tick(weight: float, start: float, total: int, text: str) -> Callable[[], None]:
        nonlocal done
        done = 0

        def step() -> None:
            nonlocal done
            done += 1
            progress(text, min(start + weight * done / max(total, 1), start + weight))

        return step

    if scheduler is not None:
        campaign_dir = Path(campaign_dir).absolute()  # Workers run in other folders.
    with workers(jobs, scheduler) as mapped:
        found, left_out = find(campaign_dir, profile, mapped)
        no_phases = why_no_phases(found[0].mode)
        columns, candidates = catalogue(without, not no_phases)
        text = 'simulating what could explain the recordings'
        outcomes = mapped(
            bind(summarise, profile=profile, columns=columns, seed=seed, prior=tuple(prior)),
            found,
            tick(0.7, 0.02, len(found), text),
        )
        evidence = [one for one in outcomes if isinstance(one, Evidence)]
        left_out += [
            (file.path.name, one)
            for file, one in zip(found, outcomes, strict=True)
            if isinstance(one, str)
        ]
        used = [
            file for file, one in zip(found, outcomes, strict=True) if isinstance(one, Evidence)
        ]
        if not evidence:
            raise nothing_left(Path(campaign_dir), left_out)
        model = Model(evidence, columns, prior)
        if not model.own.posed.any():
            candidates = [one for one in candidates if one.kind.role != 'pose']
        decision = decide(
            model, candidates, tick(0.1, 0.72, 4 * len(candidates), 'comparing explanations')
        )
        if not _seen(model).any():
            decision = replace(decision, verdict='none')  # Told as `too_little`.
        chosen = decision.chosen if decision.verdict in ('identified', 'partly') else decision.base
        effects = _effects(model, chosen)
        motions = model.own.found(chosen.nuisances)
        confirmed: list[Outcome] = mapped(
            bind(
                simulate_set,
                profile=profile,
                seed=seed,
                effects={e.name: _plain(e) for e in effects if e.role != 'pose'},
            ),
            [(file, tuple(motion)) for file, motion in zip(used, motions, strict=True)],
            tick(0.15, 0.83, len(used), 'simulating the outcome'),
        )
    progress('writing', 0.98)
    table = _table(model, decision, effects, confirmed, used, left_out)
    table['not_considered'] = _not_considered(without, no_phases, bool(model.own.posed.any()))
    table['seconds'] = round(time.monotonic() - began, 2)
    table['peak_mb'] = round(_peak_mb(min(jobs, len(found))), 1)
    table['version'] = __version__
    if decision.verdict == 'unknown':
        patch, covariate, share = fit_patch(model, decision.base.residual(model))
        effects = [patch]
        table['patch'] = {'covariate': covariate, 'shrink': share, 'held_out': len(evidence) > 1}
    if out is not None:
        write(Path(out), table, effects, model, decision, confirmed)
    progress('done', 1.0)
    return table


def _check(
    without: Collection[str], seed: int, jobs: int, pose_prior: tuple[float, float]
) -> None:
    for name in without:
        if name not in registry():
            raise InputError(f'without: must be among {", ".join(registry())}, got {name}')
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 10**9:
        raise InputError(f'seed: must be a whole number from 0, got {seed!r}')
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise InputError(f'jobs: must be a whole number from 1, got {jobs!r}')
    if len(pose_prior) != 2 or not all(0 < value < 1e3 for value in pose_prior):
        raise InputError(f'pose_prior: must be metres and degrees above 0, got {pose_prior!r}')


def _not_considered(without: Collection[str], no_phases: str, posed: bool) -> list[dict[str, str]]:
    # Effects of the registry that are not in the catalogue, and why.
    reasons = {
        name: no_phases for name, kind in registry().items() if kind.needs_modulation and no_phases
    }
    if not posed:
        reasons[of_role('pose').name] = 'the ground truth gives all poses as exact'
    reasons.update(dict.fromkeys(without, 'left out as asked for'))
    return [{'name': name, 'reason': reasons[name]} for name in registry() if name in reasons]


def _effects(model: Model, fit: Fit) -> list[Effect]:
    out, start = [], 0
    for candidate in fit.candidates:
        values = fit.values[start : start + len(candidate.terms)]
        start += len(candidate.terms)
        out.append(_effect(model, fit, candidate, tuple(float(v) for v in values)))
    return out


def _effect(model: Model, fit: Fit, candidate: Candidate, values: tuple[float, ...]) -> Effect:
    kind = registry()[candidate.effect]
    if kind.role == 'pose':
        mean = np.mean([one[:POSE] for one in model.own.found(fit.nuisances)], axis=0)
        table = dict(zip(NAMES, (float(v) for v in mean), strict=True))
    else:
        table = dict(candidate.build(values))
    if kind.lattice:
        step = float(np.median([e.step for e in model.evidence]))
        if 0.5 < step / max(table[kind.lattice], 1e-6) < 2:
            table[kind.lattice] = step
    bounds = {p.name: p for p in kind.parameters()}
    table = {k: float(np.clip(v, bounds[k].low, bounds[k].high)) for k, v in table.items()}
    return kind.from_mapping(table)


def _plain(effect: Effect) -> dict[str, float]:
    return {p.name: float(getattr(effect, p.name)) for p in effect.parameters()}


def _table(
    model: Model,
    decision: Decision,
    effects: list[Effect],
    confirmed: list[Outcome],
    used: list[Found],
    left_out: list[tuple[str, str]],
) -> dict[str, Any]:
    explained = decision.verdict in ('identified', 'partly')
    chosen = decision.chosen if explained else decision.base
    residual = chosen.residual(model)
    # What the effects change, and what is left, if that matters; not the recordings' own errors.
    difference = np.zeros_like(residual) if decision.verdict == 'identified' else residual
    added = chosen.shift(model) if explained else np.zeros_like(residual)
    seen = _seen(model)
    rows = []
    for effect, share, interval, confidence in zip(
        effects, decision.shares, decision.intervals, decision.confidences, strict=False
    ):
        rows.append(
            {
                'name': effect.name,
                'parameters': _plain(effect),
                'share': share,
                'interval': interval,
                'confidence': confidence,
            }
        )
    return {
        'schema': SCHEMA,
        'verdict': decision.verdict if seen.any() else 'too_little',
        'effects': rows,
        'alternatives': (
            [_alternative(model, one) for one in decision.alternatives]
            if decision.finds_gap
            else []
        ),
        'not_decidable': [
            {'name': one.effect, 'absorbed': one.absorbed, 'settled_by': one.settled_by}
            for one in decision.undecided
        ],
        'unexplained': (
            unexplained(model, residual, model.null_loss.sum(axis=0)) if decision.finds_gap else []
        ),
        'where': (
            places(
                model,
                difference + added,
                residual + added,
                [one.groups for one in confirmed],
                decision.verdict == 'identified',
                chosen.sigma,
            )
            if decision.finds_gap
            else []
        ),
        'gap': _gap(model, decision, confirmed),
        'recordings': [
            *(
                {
                    'name': e.name,
                    'used': True,
                    'reason': '',
                    'frames': e.frames,
                    'moving': e.moving,
                    'pose': [float(v) for v in m[:POSE]],
                    'truth': asdict(e.accuracy),
                    'notes': [
                        *file.notes,
                        *e.notes,
                        *_too_little(e, seen[i]),
                        *_same_noise(model, i),
                    ],
                }
                for i, (e, m, file) in enumerate(
                    zip(model.evidence, model.own.found(chosen.nuisances), used, strict=True)
                )
            ),
            *({'name': name, 'used': False, 'reason': reason} for name, reason in left_out),
        ],
    }


def _seen(model: Model) -> np.ndarray:
    # (R,) whether there are enough surfaces in a recording to say anything.
    return model.good[:, LAYOUT.index(Feature('bias', 'all', 0))]


def _too_little(one: Evidence, seen: bool) -> list[str]:
    if seen:
        return []
    return [
        f'{one.name}: too little to look at: {one.counts[0]:.0f} depths of surfaces away from '
        f'edges, must be at least {ENOUGH}'
    ]


def _same_noise(model: Model, index: int) -> list[str]:
    other = model.same_noise[index]
    if other is None:
        return []
    one, other_name = model.evidence[index].name, model.evidence[other].name
    return [
        f'{one}: has the very same noise as {other_name}, as simulations with the same seed '
        'and stamps have; a pattern that stays is not looked for in what recordings share'
    ]


def _alternative(model: Model, one: Alternative) -> dict[str, Any]:
    effect = _effects(model, one.fit)[-1]
    return {
        'name': effect.name,
        'parameters': _plain(effect),
        'share': one.share,
        'interval': one.interval,
        'confidence': one.confidence,
        'instead_of': list(one.instead_of),
    }


def _gap(model: Model, decision: Decision, confirmed: list[Outcome]) -> dict[str, Any]:
    explained = decision.verdict in ('identified', 'partly')
    base, chosen = decision.base, decision.chosen if explained else decision.base
    count = len(base.loss)
    null = model.null_loss.sum(axis=1) + THRESHOLDS.floor
    bottom = base.loss - null + (base.pose_loss - chosen.pose_held_out) / count
    held_out = count > 1
    top = (
        base.loss
        - (chosen.held_out if held_out else chosen.loss)
        + (base.pose_loss - chosen.pose_held_out) / count
    )
    before = float(base.loss.sum() + base.pose_loss)
    after = before - float(top.sum())
    out: dict[str, Any] = {
        'before': before,
        'after': after,
        'null': before - float(bottom.sum()),
        'shrink': float(np.clip(top.sum() / max(bottom.sum(), 1e-9), 0, 1)) if explained else 0.0,
        'interval': ratio_interval(top, bottom) if explained else [0.0, 0.0],
        'held_out': held_out,
    }
    if not held_out:
        out['note'] = (
            'one recording only: nothing was left out to check on, so shrink is that '
            'of the data the effects were fitted to'
        )
        out['interval'] = None
    for unit in UNITS:
        values = np.array([one.physical[unit] for one in confirmed])
        first, last, least = (float(v) for v in values.mean(axis=0))
        out[unit] = {
            'before': first,
            'after': last,
            'null': least,
            'shrink': float(np.clip((first - last) / (first - least), -1, 1))
            if first > least
            else 0.0,
            'interval': ratio_interval(values[:, 0] - values[:, 1], values[:, 0] - values[:, 2])
            if held_out
            else None,
        }
    return out


def _peak_mb(processes: int) -> float:
    # Of the processes the largest is known; they are much alike.
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return (own + processes * largest) / 1024

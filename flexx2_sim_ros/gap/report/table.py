"""The contents of ``diagnosis.json``."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from flexx2_sim_ros.effects import Effect, loadable, of_role, parse_effects
from flexx2_sim_ros.effects.tables import plain
from flexx2_sim_ros.effects.time_offset import changing
from flexx2_sim_ros.gap.calibration.decisions import calibrated
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.features import ENOUGH
from flexx2_sim_ros.gap.features.physical import UNITS
from flexx2_sim_ros.gap.features.simulation import counts_edges
from flexx2_sim_ros.gap.forms.calibrating import Calibrated
from flexx2_sim_ros.gap.forms.proposals import PATTERN
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.effects import fitted_effects
from flexx2_sim_ros.gap.inference.improvement import (
    all_measured,
    remaining,
    simulated_losses,
    taken_off,
)
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.patch import Patch
from flexx2_sim_ros.gap.inference.probability import p_value
from flexx2_sim_ros.gap.inference.uncertainty import ratio_interval
from flexx2_sim_ros.gap.inference.where import places, unexplained
from flexx2_sim_ros.gap.report.age import age_table, arrival_of, with_delay
from flexx2_sim_ros.gap.report.words import camera_effects, constants_of
import numpy as np

SCHEMA = 2
_ONE_RECORDING = (
    'one recording only: the reduction is measured on the recording that the effects were fitted '
    'to'
)


def diagnosis_table(
    model: Model,
    decision: Decision,
    effects: list[Effect],
    confirmed: list[Outcome],
    used: list[Found],
    left_out: list[tuple[str, str]],
    parts: Mapping[str, np.ndarray],
) -> dict[str, Any]:
    """
    Return the result of a diagnosis as a table for JSON, described in ``docs/diagnosis.md``.

    It lacks ``not_considered``, ``patch``, ``version``, ``seconds`` and ``peak_mb``. No effect is
    calibrated.

    * `effects`: those that explain the gap, with their parameters.
    * `confirmed`: the comparison of each recording with its simulation with these effects.
    * `used`: the recordings, in the order of the model.
    * `left_out`: name of each recording that was not used, and the reason.
    * `parts`: (R, 4) what each effect takes off, the largest first; see `confirm.parts`.
    """
    age = age_table(effects, used)
    residual = decision.accepted.residual(model)
    motions = model.own.found(decision.accepted.nuisances)
    finds = decision.finds_gap
    return {
        'schema': SCHEMA,
        'verdict': decision.verdict if model.seen.any() else 'too_little',
        # A delay alone explains nothing: it is not listed as an effect.
        'effects': _effect_rows(decision, changing(with_delay(effects, arrival_of(age))), parts),
        'alternatives': [
            {
                'name': (effect := fitted_effects(model, one.fit)[-1]).name,
                'parameters': effect.settings,
                'confidence': one.confidence,
                'instead_of': list(one.instead_of),
            }
            for one in decision.alternatives
            if finds
        ],
        'refused': _refused(decision),
        'not_decidable': [
            {'name': one.effect, 'absorbed': one.absorbed, 'settled_by': one.settled_by}
            for one in decision.undecided
        ],
        'disagree': decision.unlike and decision.unlike.table([one.path.name for one in used]),
        'unexplained': (
            unexplained(model, residual, model.null_loss.sum(axis=0)) if finds else []
        ),
        'where': _where(model, decision, residual, confirmed) if finds else [],
        'gap': _gap(model, decision, confirmed, motions),
        'calibration': None,
        'age': age,
        'evidence': decision.support.as_table(),
        'recordings': _recordings(model, decision, used, left_out),
    }


def verdict_of(table: dict[str, Any]) -> str:
    """
    Return the verdict of a diagnosis after its effects were simulated.

    Effects of the camera explain it partly if they close less than four fifths of the gap, leave
    more than the tolerance, come from a single recording or from recordings that disagree, or have
    a constant for a form: other causes do the same. What they do beside an error of the poses
    shows at the fitted poses.
    """
    verdict = str(table['verdict'])
    names = [row['name'] for row in table['effects']]
    simulated = names[:1] not in ([], [of_role('pose').name])
    closed = _closes(table) >= THRESHOLDS.identified and not _leaves_more(table)
    shared = table['gap']['held_out'] and not table['disagree']
    sure = closed and shared and not constants_of(table)
    return 'partly' if verdict == 'identified' and simulated and not sure else verdict


def makes_larger(table: dict[str, Any]) -> bool:
    """Return whether the named effects of the camera make the gap larger when simulated."""
    measured = bool(camera_effects(table)) and table['gap']['measured_by'] == 'distance'
    larger = measured and _closes(table) < -THRESHOLDS.larger
    # Beside poses the gap may be small, and a fraction of it says little.
    rows = (table.get('calibration') or {}).get('effects', [])
    beside = any(row['taken'] and loadable()[row['name']].scale for row in rows)
    return larger and (not beside or bool(table['gap']['distance']['worse']))


def _closes(table: dict[str, Any]) -> float:
    # The fraction of the gap that goes away, at the fitted poses where an error of them is named.
    gap = table['gap']
    return float((gap['at_fitted_poses'] if _is_posed(table) else gap)['shrink'])


def _leaves_more(table: dict[str, Any]) -> bool:
    # Whether what is left is more than the tolerance, where it is a distance.
    gap = table['gap']
    left = gap['at_fitted_poses'] if _is_posed(table) else gap['distance']
    beyond = left['after'] - left['null'] > gap['distance']['tolerance']
    return bool(gap['measured_by'] == 'distance' and beyond)


def _is_posed(table: dict[str, Any]) -> bool:
    names = [row['name'] for row in table['effects']]
    return of_role('pose').name in names and table['gap']['measured_by'] == 'distance'


def calibrated_table(
    table: dict[str, Any],
    model: Model,
    decision: Decision,
    calibrated: Calibrated,
    confirmed: list[Outcome],
    motions: Sequence[np.ndarray],
) -> dict[str, Any]:
    """
    Return a diagnosis with the forms of effects that are taken, and the gap that they leave.

    What was decided, and where the gap lies, stays. `table` is as from `diagnosis_table`;
    `confirmed` compares each recording with its simulation with these forms; `motions` are (6 + 3
    P,) where the camera of each recording was then.
    """
    late = with_delay(parse_effects(calibrated.explained.effects), arrival_of(table['age']))
    forms = {one.name: plain(one.settings) for one in late}
    verdicts = [
        {**one.as_table(), 'typical': plain(calibrated.typical[one.proposal.effect])}
        for one in calibrated.explained.verdicts
    ]
    before = {key: table['gap'][key] for key in ('shrink', 'interval', 'measured_by')}
    dropped = [row['name'] for row in table['effects'] if row['name'] in calibrated.dropped]
    about = {'effects': verdicts, 'dropped': dropped, 'typical_gap': before}
    out = {**table, 'calibration': about}
    if not calibrated.taken:
        return out
    out['effects'] = [
        {**row, 'parameters': forms.get(row['name'], row['parameters'])}
        for row in table['effects']
        if row['name'] not in dropped
    ]
    hidden = calibrated.explained.beside_poses
    out['gap'] = _gap(model, decision, confirmed, motions, dropped, hidden)
    taken = [row['name'] for row in verdicts if row['taken'] and row['name'] != PATTERN]
    parts = zip(out['recordings'], motions, calibrated.explained.now, strict=False)
    for row, motion, own in parts:  # Those used are first.
        row['pose'] = [float(v) for v in motion[:POSE]]
        row['forms_without'] = {name: plain(own[name]) for name in taken}
    return out


def patch_table(patch: Patch, model: Model, patched: list[Outcome]) -> dict[str, Any]:
    """
    Return what a correction without a cause does, and whether it is offered.

    It is offered if the mean distance gets smaller and a measure significantly better. `patched`
    compares each recording with its simulation with the correction.
    """
    measures = all_measured(model, [one.apart for one in patched])
    helps = any(measures[unit]['better'] for unit in UNITS)
    offered, told = helps and measures['distance']['change'] < 0, len(patched) > 1
    first = {'covariate': patch.covariate, 'shrink': patch.shrink}
    return {**first, 'offered': offered, 'held_out': told, **measures}


def _effect_rows(
    decision: Decision, effects: Sequence[Effect], parts: Mapping[str, np.ndarray]
) -> list[dict[str, Any]]:
    rows = {
        one.name: {
            'name': one.name,
            'parameters': one.settings,
            'takes_off': taken_off(parts[one.name]) if one.name in parts else None,
            'confidence': confidence,
        }
        for one, confidence in zip(effects, decision.confidences, strict=False)
    }
    # A pose error has no part, and stays where it is.
    largest = (rows[name] for name in parts if name in rows)
    return [next(largest) if name in parts else row for name, row in rows.items()]


def _refused(decision: Decision) -> list[dict[str, str]]:
    # An effect that does not improve the fit of left-out recordings was not found.
    found = decision.verdict == 'unknown' and decision.support.gain > 0
    names = [one.effect for one in decision.chosen.candidates] if found else []
    return [{'name': name, 'reason': decision.why_refused} for name in names]


def _where(
    model: Model, decision: Decision, residual: np.ndarray, confirmed: list[Outcome]
) -> list[dict[str, Any]]:
    # The listed difference is what the effects change plus, if the effects do not explain the gap
    # completely, the residual. Nuisances of the recordings are not part of it.
    identified, explained = decision.verdict == 'identified', decision.explains_gap
    added = decision.accepted.shift(model) if explained else np.zeros_like(residual)
    return places(
        model,
        added + (0.0 if identified else residual),
        residual + added,
        [one.groups for one in confirmed],
        identified,
        decision.accepted.sigma,
        [one.kind for one in decision.accepted.candidates] if explained else [],
    )


def _recordings(
    model: Model, decision: Decision, used: list[Found], left_out: list[tuple[str, str]]
) -> list[dict[str, Any]]:
    motions = model.own.found(decision.accepted.nuisances)
    rows: list[dict[str, Any]] = [
        {
            'name': one.name,
            'used': True,
            'reason': '',
            'frames': one.frames,
            'moving': one.moving,
            'pose': [float(v) for v in motion[:POSE]],
            'truth': asdict(one.accuracy),
            'checksum': one.checksum,
            'arrival': None if file.arrival is None else asdict(file.arrival),
            'notes': [*file.notes, *one.notes, *_notes(model, index)],
        }
        for index, (one, motion, file) in enumerate(
            zip(model.evidence, motions, used, strict=True)
        )
    ]
    return rows + [{'name': name, 'used': False, 'reason': reason} for name, reason in left_out]


def _notes(model: Model, index: int) -> Iterator[str]:
    one, other = model.evidence[index], model.same_noise[index]
    if not model.seen[index]:
        yield (
            f'{one.name}: too little to look at: must have at least {ENOUGH} depths on surfaces '
            f'away from edges whose noise is small enough to compare, got {one.compared}'
        )
    if other is not None:
        yield (
            f'{one.name}: has the very same noise as {model.evidence[other].name}, as simulations '
            'with the same seed and stamps have; fixed-pattern noise that all recordings share is '
            'not examined'
        )


def _gap(
    model: Model,
    decision: Decision,
    confirmed: list[Outcome],
    motions: Sequence[np.ndarray],
    dropped: Collection[str] = (),
    hidden: bool = False,
) -> dict[str, Any]:
    # `hidden`: poses hide an effect that was fitted beside them, and the loss leaves poses free.
    held_out = len(confirmed) > 1
    there, here = [one.elsewhere for one in confirmed], [one.apart for one in confirmed]
    measures, fitted = all_measured(model, there), all_measured(model, here)['distance']
    # Some differences, such as depth in steps of half a millimetre, show in the features only.
    shown = np.mean([one.gap for one in there]) >= 1.0
    # An error of the poses is corrected and not simulated: if it is all, nothing is removed.
    only_posed = {one.kind.role == 'pose' for one in decision.accepted.candidates} == {True}
    by_distance = bool(shown) or hidden or only_posed
    loss = _loss(model, decision, confirmed, motions, dropped)
    headline = measures['distance'] if by_distance else loss
    p = p_value(decision.support, calibrated()) if model.seen.any() else None
    out: dict[str, Any] = {
        'p_value': p and round(p, 4),
        'shrink': headline['shrink'],
        'interval': _interval(decision, headline),
        'measured_by': 'distance' if by_distance else 'loss',
        'held_out': held_out,
        'at_fitted_poses': {key: fitted[key] for key in ('shrink', 'before', 'after', 'null')},
        **remaining(there, here),
        'noise_factor': 1 + decision.accepted.sigma,
        'loss': loss,
        **measures,
    }
    if not held_out:
        out['note'] = _ONE_RECORDING
    return out


def _interval(decision: Decision, headline: dict[str, Any]) -> list[float] | None:
    # The interval over recordings, widened until it holds on other scenes as often as it says.
    own, support = headline['shrink_interval'], decision.support
    told = decision.verdict, support.recordings, support.depths
    return calibrated().widened(own, headline['shrink'], *told) or own


def _loss(
    model: Model,
    decision: Decision,
    confirmed: list[Outcome],
    motions: Sequence[np.ndarray],
    dropped: Collection[str],
) -> dict[str, Any]:
    # The reduction of the loss of each recording by a perfect simulation, and by these effects.
    poses = {one.effect: one.kind.role == 'pose' for one in decision.accepted.candidates}
    edges = counts_edges([name for name, pose in poses.items() if not pose])
    posed = any(pose for name, pose in poses.items() if name not in dropped)
    fits = (model, decision.base), (model, decision.accepted)
    before, after, noise = simulated_losses(*fits, confirmed, motions, edges, posed).T
    if not decision.explains_gap:
        after = before
    possible, taken = before - noise, before - after
    least = THRESHOLDS.least_shrink
    return {
        'before': float(before.sum()),
        'after': float(after.sum()),
        'null': float(noise.sum()),
        'shrink': float(np.clip(taken.sum() / max(possible.sum(), 1e-9), least, 1)),
        'shrink_interval': ratio_interval(taken, possible),
    }

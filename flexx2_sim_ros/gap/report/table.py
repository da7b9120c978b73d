"""The contents of ``diagnosis.json``."""

from dataclasses import asdict
from typing import Any

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import ENOUGH
from flexx2_sim_ros.gap.features.physical import UNITS
from flexx2_sim_ros.gap.inference.decide import Alternative, Decision
from flexx2_sim_ros.gap.inference.effects import fitted_effects
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.uncertainty import ratio_interval
from flexx2_sim_ros.gap.inference.where import places, unexplained
import numpy as np

SCHEMA = 1


def diagnosis_table(
    model: Model,
    decision: Decision,
    effects: list[Effect],
    confirmed: list[Outcome],
    used: list[Found],
    left_out: list[tuple[str, str]],
) -> dict[str, Any]:
    """
    Return the result of a diagnosis as a table for JSON.

    Parameters
    ----------
    model : Model
        The recordings.
    decision : Decision
        Which effects explain the gap.
    effects : list of Effect
        Those effects with their parameters.
    confirmed : list of Outcome
        One for each recording: its comparison with the simulation with these effects.
    used : list of Found
        The files of the recordings, in the order of the model.
    left_out : list of tuple of str
        Name of each recording that was not used, and the reason.

    Returns
    -------
    dict
        As in ``docs/diagnosis.md``, without ``not_considered``, ``patch``, ``version`` and what
        the run took.

    """
    residual = decision.accepted.residual(model)
    finds = decision.finds_gap
    return {
        'schema': SCHEMA,
        'verdict': decision.verdict if model.seen.any() else 'too_little',
        'effects': _effect_rows(decision, effects),
        'alternatives': [_alternative(model, one) for one in decision.alternatives if finds],
        'not_decidable': [
            {'name': one.effect, 'absorbed': one.absorbed, 'settled_by': one.settled_by}
            for one in decision.undecided
        ],
        'unexplained': (
            unexplained(model, residual, model.null_loss.sum(axis=0)) if finds else []
        ),
        'where': _where(model, decision, residual, confirmed) if finds else [],
        'gap': _gap(model, decision, confirmed),
        'recordings': _recordings(model, decision, used, left_out),
    }


def _effect_rows(decision: Decision, effects: list[Effect]) -> list[dict[str, Any]]:
    return [
        {
            'name': effect.name,
            'parameters': effect.settings,
            'share': fraction,
            'interval': interval,
            'confidence': confidence,
        }
        for effect, fraction, interval, confidence in zip(
            effects, decision.shares, decision.intervals, decision.confidences, strict=False
        )
    ]


def _alternative(model: Model, one: Alternative) -> dict[str, Any]:
    effect = fitted_effects(model, one.fit)[-1]
    return {
        'name': effect.name,
        'parameters': effect.settings,
        'share': one.share,
        'interval': one.interval,
        'confidence': one.confidence,
        'instead_of': list(one.instead_of),
    }


def _where(
    model: Model, decision: Decision, residual: np.ndarray, confirmed: list[Outcome]
) -> list[dict[str, Any]]:
    # The listed difference is what the effects change plus, if the effects do not explain the gap
    # completely, the residual. Nuisances of the recordings are not part of it.
    identified = decision.verdict == 'identified'
    difference = np.zeros_like(residual) if identified else residual
    added = decision.accepted.shift(model) if decision.explains_gap else np.zeros_like(residual)
    return places(
        model,
        difference + added,
        residual + added,
        [one.groups for one in confirmed],
        identified,
        decision.accepted.sigma,
    )


def _recordings(
    model: Model, decision: Decision, used: list[Found], left_out: list[tuple[str, str]]
) -> list[dict[str, Any]]:
    motions = model.own.found(decision.accepted.nuisances)
    rows: list[dict[str, Any]] = []
    for index, (one, motion, file) in enumerate(zip(model.evidence, motions, used, strict=True)):
        rows.append(
            {
                'name': one.name,
                'used': True,
                'reason': '',
                'frames': one.frames,
                'moving': one.moving,
                'pose': [float(v) for v in motion[:POSE]],
                'truth': asdict(one.accuracy),
                'checksum': one.checksum,
                'notes': [
                    *file.notes,
                    *one.notes,
                    *_too_little(one, model.seen[index]),
                    *_same_noise(model, index),
                ],
            }
        )
    return rows + [{'name': name, 'used': False, 'reason': reason} for name, reason in left_out]


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


def _gap(model: Model, decision: Decision, confirmed: list[Outcome]) -> dict[str, Any]:
    explained, base, accepted = decision.explains_gap, decision.base, decision.accepted
    count = len(base.loss)
    held_out = count > 1
    poses = (base.pose_loss - accepted.pose_held_out) / count
    null = model.null_loss.sum(axis=1) + THRESHOLDS.floor
    # What a perfect simulation, and what these effects, take off each recording's loss.
    possible = base.loss - null + poses
    taken = base.loss - (accepted.held_out if held_out else accepted.loss) + poses
    before = float(base.loss.sum() + base.pose_loss)
    out: dict[str, Any] = {
        'before': before,
        'after': before - float(taken.sum()),
        'null': before - float(possible.sum()),
        'shrink': (
            float(np.clip(taken.sum() / max(possible.sum(), 1e-9), 0, 1)) if explained else 0.0
        ),
        'interval': ratio_interval(taken, possible) if explained else [0.0, 0.0],
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
        out[unit] = _physical_gap(values, held_out)
    return out


def _physical_gap(values: np.ndarray, held_out: bool) -> dict[str, Any]:
    # values: (R, 3) without effects, with effects, and between two runs of the simulation.
    before, after, null = (float(v) for v in values.mean(axis=0))
    shrink = float(np.clip((before - after) / (before - null), -1, 1)) if before > null else 0.0
    taken, possible = values[:, 0] - values[:, 1], values[:, 0] - values[:, 2]
    return {
        'before': before,
        'after': after,
        'null': null,
        'shrink': shrink,
        'interval': ratio_interval(taken, possible) if held_out else None,
    }

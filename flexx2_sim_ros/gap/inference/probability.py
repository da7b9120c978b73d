"""
How probable a gap and each effect are, given the evidence.

Logistic models of the evidence, fitted to simulated campaigns by
``python -m bench.calibrate_decisions``; ``config/decisions.yaml`` has their weights.
"""

from dataclasses import dataclass, replace

from flexx2_sim_ros.effects import of_role
from flexx2_sim_ros.gap.calibration.decisions import Decisions
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.inference.support import Support
import numpy as np

_POSE = of_role('pose').name
Rows = dict[str, dict[str, float]]  # evidence by its name, for each effect
EXPLAINED = 'identified', 'partly'  # the verdicts that name effects


@dataclass(frozen=True)
class Judgement:
    """
    What the evidence says.

    * `verdict`: ``none``, ``unknown``, ``partly`` or ``identified``.
    * `gap`: probability that there is a gap.
    * `effects`: probability of each effect that was chosen or could be in place of the last chosen
      one.
    * `alternatives`: effects that are probable enough to be listed as alternatives.
    * `refused`: with ``unknown``, why the chosen effects are not named: ``improbable``, or
      ``little``, as they explain too little of the gap; otherwise empty.
    """

    verdict: str
    gap: float
    effects: dict[str, float]
    alternatives: frozenset[str]
    refused: str = ''


def judge(support: Support, rule: Decisions) -> Judgement:
    """Judge the evidence of a campaign by the calibrated rule."""
    gap = rule.gap.probability(gap_evidence(support))
    chosen, rivals = effect_evidence(support)
    effects = {
        name: model.probability(row)
        for model, rows in ((rule.effect, chosen), (rule.rival, rivals))
        for name, row in rows.items()
    }
    best = max((effects[one.name] for one in support.chosen), default=0.0)
    refused = ''
    if not has_gap(support, gap, rule):
        verdict = 'none'
    elif best < rule.least_effect or explain_little(support):
        verdict = 'unknown'
        refused = 'improbable' if best < rule.least_effect else 'little'
    else:
        verdict = 'partly' if explain_partly(support, best, rule) else 'identified'
    probable = (name for name, one in effects.items() if one >= rule.least_alternative)
    return Judgement(verdict, gap, effects, frozenset(probable), refused)


def has_gap(support: Support, probability: float, rule: Decisions) -> bool:
    """
    Return whether the evidence is enough to report a gap, given the gap's probability.

    A large excess loss is reported even if no effect explains it. So are poses that scatter if a
    pose error explains it best, or may not be named: it leaves little loss, because the pose that
    is fitted to each recording takes it over.
    """
    named = is_posed(support) or _POSE not in {one.name for one in support.considered}
    return (
        (named and support.scatter > THRESHOLDS.scattered_alone)
        or agreement(support) >= rule.thresholds.agreement
        or _loss_shows_gap(support, probability, rule)
    )


def _loss_shows_gap(support: Support, probability: float, rule: Decisions) -> bool:
    least, depths = rule.thresholds, support.depths
    large = support.excess >= least.excess_from(support.scatter, depths)
    return large or probability >= least.probability_from(depths)


def p_value(support: Support, rule: Decisions) -> float:
    """
    Return in which part of the campaigns without an effect the evidence of a gap is as large.

    It is a p-value of "the simulation is the camera". Poses are no part of the camera, and do not
    count.
    """
    return rule.p_value(gap_evidence(support), support.depths)


def agreement(support: Support) -> float:
    """
    Return how much the recordings agree that the chosen effects improve the simulation.

    It finds a gap that leaves no excess loss, because the recordings' own poses can take it over,
    such as at bare walls.
    """
    t = min(max(support.t, 0.0), THRESHOLDS.most_t)
    return float(np.arcsinh(max(support.gain, 0.0)) * t)


def is_posed(support: Support) -> bool:
    """Return whether a pose error is among the chosen effects."""
    return _POSE in {one.name for one in support.chosen}


def explain_little(support: Support) -> bool:
    """Return whether the chosen effects explain too little of the gap to be named."""
    # A pose error is exempt: the recordings' own poses absorb most of it.
    return not is_posed(support) and support.left > (1 - THRESHOLDS.unknown) * support.excess


def explain_partly(support: Support, best: float, rule: Decisions) -> bool:
    """
    Return whether the chosen effects, if they are named, explain the gap only partly.

    They do where the probability of the most probable one, ``best``, is low, and where they leave
    most of the gap and what is left is a gap.
    """
    return best < THRESHOLDS.likely or _leave_gap(support, rule)


def _leave_gap(support: Support, rule: Decisions) -> bool:
    nothing = (0.0,) * support.recordings
    rest = replace(support, excess=support.left, gain=0.0, improved=nothing, chosen=())
    probability = rule.gap.probability(gap_evidence(rest))
    most = support.left > THRESHOLDS.partly * support.excess
    return most and _loss_shows_gap(rest, probability, rule)


def gap_evidence(support: Support) -> dict[str, float]:
    """Return what tells a gap from none, by name."""
    return {
        name: float(np.arcsinh(getattr(support, name)))
        for name in ('excess', 'gain', 'least_gain')
    }


def effect_evidence(support: Support) -> tuple[Rows, Rows]:
    """
    Return what tells effects that are present from others: rows of the chosen, and of rivals.

    Each chosen effect, and each other one that could be in place of the last one, has ``gain``,
    its gain; ``lead``, by how much it is better than the best other explanation (negative: worse);
    ``left``, the fraction of the excess loss that the chosen effects leave; ``scatter`` of the
    poses.
    """
    if not support.chosen:
        return {}, {}
    last, excess = support.chosen[-1], max(support.excess, 1e-9)
    left = float(np.clip(support.left / excess, 0.0, 1.5))

    def row(gain: float, lead: float) -> dict[str, float]:
        return {
            'gain': float(np.arcsinh(gain)),
            'lead': float(np.arcsinh(lead)),
            'left': left,
            'scatter': support.scatter,
        }

    nearest = max(support.rivals[0].gain if support.rivals else 0.0, 0.0)
    chosen = {one.name: row(one.gain, one.gain) for one in support.chosen[:-1]}
    chosen[last.name] = row(last.gain, last.gain - nearest)
    others = {
        one.name: row(one.gain, one.gain - last.gain)
        for one in support.rivals[::-1]
        if one.name not in chosen
    }
    return chosen, others

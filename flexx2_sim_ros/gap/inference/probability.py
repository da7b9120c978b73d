"""
Whether there is a gap, and how probable each effect is, given the evidence.

Logistic models of the evidence, fitted to simulated campaigns by
``python -m bench.calibrate_decisions``; ``config/decisions.yaml`` has their weights.
"""

from dataclasses import dataclass

from flexx2_sim_ros.effects import of_role
from flexx2_sim_ros.gap.calibration.decisions import Decisions, GapTest
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

    Attributes
    ----------
    verdict : str
        ``none``, ``unknown``, ``partly`` or ``identified``.
    p_value : float
        Fraction of campaigns without an effect with as much evidence of a gap; see `GapTest`.
    effects : dict of str to float
        Probability of each effect that was chosen or could be in place of the last chosen one.
    alternatives : frozenset of str
        Effects that are probable enough to be listed as alternatives.
    refused : str
        With ``unknown``, why the chosen effects are not named: ``improbable``, or ``little``, as
        they explain too little of the gap; otherwise empty.

    """

    verdict: str
    p_value: float
    effects: dict[str, float]
    alternatives: frozenset[str]
    refused: str = ''


def judge(support: Support, rule: Decisions) -> Judgement:
    """
    Judge the evidence of a campaign.

    Parameters
    ----------
    support : Support
        The evidence.
    rule : Decisions
        The calibrated rule.

    """
    p_value = gap_p_value(support, rule.gap)
    chosen, rivals = effect_evidence(support)
    effects = {
        name: model.probability(row)
        for model, rows in ((rule.effect, chosen), (rule.rival, rivals))
        for name, row in rows.items()
    }
    best = max((effects[one.name] for one in support.chosen), default=0.0)
    refused = ''
    if p_value > rule.gap.level:
        verdict = 'none'
    elif best < rule.least_effect or explain_little(support):
        verdict = 'unknown'
        refused = 'improbable' if best < rule.least_effect else 'little'
    else:
        verdict = 'partly' if explain_partly(support, best) else 'identified'
    probable = (name for name, one in effects.items() if one >= rule.least_alternative)
    return Judgement(verdict, p_value, effects, frozenset(probable), refused)


def gap_p_value(support: Support, test: GapTest) -> float:
    """Return the p-value of the evidence of a campaign."""
    return test.p_value(test.score(test.model.log_odds(gap_evidence(support)), support.depths))


def is_posed(support: Support) -> bool:
    """Return whether a pose error is among the chosen effects."""
    return _POSE in {one.name for one in support.chosen}


def explain_little(support: Support) -> bool:
    """Return whether the chosen effects explain too little of the gap to be named."""
    # A pose error is exempt: the recordings' own poses absorb most of it.
    return not is_posed(support) and support.left > (1 - THRESHOLDS.unknown) * support.excess


def explain_partly(support: Support, best: float) -> bool:
    """
    Return whether the chosen effects, if they are named, explain the gap only partly.

    They do where the probability of the most probable one, ``best``, is low, and where they leave
    most of the gap.
    """
    return best < THRESHOLDS.likely or support.left > THRESHOLDS.partly * support.excess


def gap_evidence(support: Support) -> dict[str, float]:
    """
    Return what tells a gap from none, by name.

    The excess loss; how much the recordings agree that the chosen effects improve the simulation,
    which finds a gap whose loss the recordings' own poses take over, such as at bare walls;
    whether a pose error is among them; and by how much the poses scatter more than usual.
    """
    t = min(max(support.t, 0.0), THRESHOLDS.most_t)
    return {
        'excess': float(np.arcsinh(support.excess)),
        'agreement': float(np.arcsinh(max(support.gain, 0.0)) * t),
        'posed': float(is_posed(support)),
        'scattered': max(support.scatter - THRESHOLDS.scattered_alone, 0.0),
    }


def effect_evidence(support: Support) -> tuple[Rows, Rows]:
    """
    Return what tells effects that are present from others.

    Parameters
    ----------
    support : Support
        The evidence of a campaign.

    Returns
    -------
    tuple of dict of str to dict of str to float
        For each chosen effect, and for each other one that could be in place of the last one:
        ``gain``, its gain; ``lead``, by how much it is better than the best other explanation
        (negative: worse); ``left``, the fraction of the excess loss that the chosen effects leave;
        ``scatter`` of the poses.

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

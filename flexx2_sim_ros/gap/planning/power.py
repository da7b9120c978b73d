"""
Power calculation: the smallest strength at which the diagnosis finds an effect.

An effect's shift of all features is simulated once at each strength. Noise of the features comes
from the simulations without effects, errors of the ground truth from its covariance. The fit and
the calibrated rule of the verdict then decide on many draws, without any further simulation.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.calibration.decisions import calibrated
from flexx2_sim_ros.gap.data.pose import STEPS
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.data.unknown import PLANE_STEPS
from flexx2_sim_ros.gap.features.catalogue import Candidate, Column
from flexx2_sim_ros.gap.inference.decidable import undecided
from flexx2_sim_ros.gap.inference.decide import hidden_could_explain
from flexx2_sim_ros.gap.inference.model import combine, Model
from flexx2_sim_ros.gap.inference.own_errors import COMMON
from flexx2_sim_ros.gap.inference.probability import EXPLAINED, judge
from flexx2_sim_ros.gap.inference.selection import (
    best_of_each,
    Choice,
    Selection,
    Trials,
    without_each,
)
from flexx2_sim_ros.gap.inference.support import support_of
from flexx2_sim_ros.gap.planning.truths import TruthKind
import numpy as np

STRENGTHS = (0.1, 0.25, 0.5, 1.0, 2.0)
_WANTED = 0.9
_TYPICAL = 0.5  # strength at which rival explanations are selected
_DRAWS = 6
_RIVALS = 3


@dataclass(frozen=True)
class Power:
    """
    How well a plan finds one effect, with one kind of ground truth.

    `found` is the fraction of draws in which it is found, by strength; only tried strengths.
    `undecided`: the ground truth cannot decide the effect at any strength.
    """

    effect: str
    found: dict[float, float]
    undecided: bool = False

    @property
    def smallest(self) -> float | None:
        """Return the strength from which on the effect is found in 90 % of draws, or None."""
        least = None
        for strength in sorted(self.found, reverse=True):
            if self.found[strength] < _WANTED:
                break
            least = strength
        return least


def planned_columns(modulation: bool = True) -> list[Column]:
    """
    Return the simulations of all effects at all strengths, in addition to the catalogue.

    Effects that need modulation frequencies are left out if these are not known, as in
    `catalogue`.
    """
    return [
        Column(
            _column_name(name, strength),
            {name: {'strength': strength}},
            all(term.few for one in kind.hypotheses for term in one.terms),
        )
        for name, kind in registry().items()
        if modulation or not kind.needs_modulation
        for strength in STRENGTHS
    ]


def _column_name(effect: str, strength: float) -> str:
    return f'plan:{effect}:{strength:g}'


def left_open(model: Model, candidates: Sequence[Candidate], kind: TruthKind) -> set[str]:
    """Return the effects that the ground truth leaves undecided."""
    return {one.effect for one in undecided(model, candidates) if one.confounded} | set(kind.never)


def power(
    effect: str,
    model: Model,
    candidates: Sequence[Candidate],
    hidden: set[str],
    kind: TruthKind,
    seed: int,
    draws: int = _DRAWS,
) -> Power:
    """
    Compute how often an effect is found in `draws` at each strength.

    It is found if the diagnosis names it first, and no effect that the ground truth leaves
    undecided (`hidden`, as from `left_open`) explains about as much. `model` has the recordings
    without effects, with the columns of `planned_columns`.
    """
    if effect in hidden:
        return Power(effect, {}, True)
    # As in the diagnosis, what the truth takes away wholly explains nothing.
    candidates = [one for one in candidates if one.effect not in kind.never]
    if not model.own.posed.any():
        candidates = [one for one in candidates if one.kind.role != 'pose']
    if not any(one.effect == effect for one in candidates):
        return Power(effect, {}, True)
    decidable, others = _considered(model, candidates, hidden, effect)

    def fraction(strength: float) -> float:
        shift = model.column(_column_name(effect, strength))
        if _first_effect(_singles(Trials(model.as_if(shift)), decidable)) != effect:
            return 0.0  # It does not explain the gap best even without noise.
        count = misses = 0
        for draw in range(draws):
            rng = np.random.default_rng([seed, draw])
            gap = shift + noise(model, rng) + wrong_truth(model, kind.fitted, rng)
            misses += not _is_found(Trials(model.as_if(gap)), decidable, others, effect)
            count += 1
            if misses > (1 - _WANTED) * draws:
                break  # It can no longer reach 90 %.
        return 1 - misses / count

    found: dict[float, float] = {}
    # Starts at typical strength: if the effect is found, weaker ones are tried, else stronger
    # ones.
    middle = len(STRENGTHS) // 2
    for strengths, going_on in ((STRENGTHS[middle::-1], True), (STRENGTHS[middle + 1 :], False)):
        if not going_on and found[STRENGTHS[middle]] >= _WANTED:
            break
        for strength in strengths:
            found[strength] = fraction(strength)
            if (found[strength] >= _WANTED) != going_on:
                break
    return Power(effect, found)


def _considered(
    model: Model, candidates: Sequence[Candidate], hidden: Set[str], effect: str
) -> tuple[list[Candidate], list[Candidate]]:
    # The best variant of the effect, and the effects that explain its gap next best, without
    # noise: of effects that can be decided, and of those left undecided.
    trials = Trials(model.as_if(model.column(_column_name(effect, _TYPICAL))))
    singles = best_of_each([trials.choice([one]) for one in candidates])
    best = [one.fit.candidates[0] for one in singles]
    own = [one for one in best if one.effect == effect]
    rivals = [one for one in best if one.effect != effect]
    return (
        own + [one for one in rivals if one.effect not in hidden][:_RIVALS],
        [one for one in rivals if one.effect in hidden][:_RIVALS],
    )


def _is_found(
    trials: Trials, decidable: list[Candidate], hidden: list[Candidate], effect: str
) -> bool:
    singles = _singles(trials, decidable)
    if _first_effect(singles) != effect:
        return False
    first, *rivals = singles
    selection = Selection(first, tuple(rivals))
    support = support_of(trials, selection, without_each(trials, first), singles)
    if judge(support, calibrated()).verdict not in EXPLAINED:
        return False
    if not hidden:
        return True
    # The diagnosis ends `unknown` where an undecided effect explains about as much.
    singles += [trials.single(one) for one in hidden]
    names = {one.effect for one in hidden}
    return not hidden_could_explain(trials, first, [*decidable, *hidden], singles, names)


def _singles(trials: Trials, decidable: list[Candidate]) -> list[Choice]:
    return best_of_each([trials.single(one) for one in decidable])


def _first_effect(singles: Sequence[Choice]) -> str:
    return singles[0].fit.candidates[0].effect


def noise(model: Model, rng: np.random.Generator) -> np.ndarray:
    """Return (R, SIZE) noise of features: one simulation of each recording minus the others."""
    out = []
    for one in model.evidence:
        k = int(rng.integers(len(one.nulls)))
        out.append(one.nulls[k] - np.delete(one.nulls, k, axis=0).mean(axis=0))
    return np.nan_to_num(np.array(out))


def wrong_truth(model: Model, fitted: bool, rng: np.random.Generator) -> np.ndarray:
    """
    Return (R, SIZE) shift of the features by random errors of the ground truth, linearised.

    Planes that are `fitted` to the recordings are where the recordings have them.
    """
    amounts = np.zeros((len(model.gap), model.own.count))
    for row, one in zip(amounts, model.evidence, strict=True):
        covariance = one.covariance
        if covariance is None or fitted:
            continue
        deviation = np.sqrt(np.diag(covariance)) * rng.standard_normal(len(covariance))
        row[:POSE] = deviation[:POSE] / STEPS
        planes = deviation[POSE:] / np.resize(PLANE_STEPS, len(covariance) - POSE)
        row[COMMON : COMMON + len(planes)] = planes
    columns, _ = model.nuisance_columns([], np.zeros((len(amounts), 0)))
    return combine(amounts, columns)

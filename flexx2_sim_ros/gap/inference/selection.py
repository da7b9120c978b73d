"""
Add effects and take effects off by leave-one-out cross-validation.

Effects are added one at a time. Each step adds the effect that reduces the loss on left-out
recordings most, as long as recordings agree on it. Then effects that the others make unnecessary
are taken off. This is stepwise selection: Hastie, Tibshirani and Friedman, The Elements of
Statistical Learning, 2009, section 3.3.2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from flexx2_sim_ros.gap.calibration.inference import ROUNDS, THRESHOLDS
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.decidable import constants, decidable_part
from flexx2_sim_ros.gap.inference.fitting import Fit, fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.uncertainty import advantage
import numpy as np


@dataclass(frozen=True)
class Choice:
    """
    A set of candidates, fitted, and what it gains.

    `gain` is the reduction of the loss on left-out recordings, minus a cost for each parameter.
    """

    fit: Fit
    gain: float


@dataclass(frozen=True)
class Selection:
    """
    Effects selected so far.

    `rivals` are sets with another effect in place of the last one, best first; `gained` is the
    gain without the last effect.
    """

    chosen: Choice
    rivals: tuple[Choice, ...] = ()
    gained: float = 0.0


class Trials:
    """
    Fits of candidate sets, each weighed against the base simulator.

    Of the recordings there are `count`, `base`, the fit without any effect, and `null`, the loss
    of recordings that are nothing but the base simulator's.
    """

    def __init__(self, model: Model) -> None:
        """Fit the base simulator."""
        self.model, self.count = model, len(model.gap)
        self.base = fit(model, [])
        self.null = float(model.null_loss.sum()) + THRESHOLDS.floor * self.count

    def choice(
        self,
        parts: Sequence[Candidate],
        start: np.ndarray | None = None,
        scales: Sequence[float] | None = None,
    ) -> Choice:
        """Fit a candidate set; arguments as for `fit`."""
        one = fit(self.model, parts, start, scales)
        posed = any(c.kind.role == 'pose' for c in parts)
        terms = len(one.values) + THRESHOLDS.pose_terms * posed
        cost = self.count * (THRESHOLDS.term_cost * terms + _oddity(one))
        return Choice(one, self.base.total - one.total - cost)

    def single(self, candidate: Candidate) -> Choice:
        """Fit one candidate: from nothing, and from a simulated value past a local optimum."""
        tries = [self.choice([candidate])]
        if len(candidate.terms) == 1 and len(candidate.terms[0].nodes) > 1:
            value, _ = candidate.terms[0].nodes[len(candidate.terms[0].nodes) // 2]
            tries.append(
                self.choice([candidate], np.array([value]), self.model.constants.scales_from_value)
            )
        return max(tries, key=lambda one: one.gain)

    def excess(self, chosen: Choice) -> float:
        """Return the excess loss: that of the base simulator above noise alone."""
        return max(self.base.inside - self.null - chosen.fit.pose_loss, 1e-9)


def best_of_each(choices: Sequence[Choice], last: bool = False) -> list[Choice]:
    """Return the best choice of each first (or last) effect, best first."""
    best: dict[str, Choice] = {}
    for one in sorted(choices, key=lambda c: -c.gain):
        names = [c.effect for c in one.fit.candidates]
        best.setdefault(names[-1 if last else 0], one)
    return list(best.values())


@dataclass(frozen=True)
class FittedSet:
    """
    A set of effects as fitted.

    `kept` has the columns of the set without each effect that the base simulator has; `added` are
    the effects that are new.
    """

    trials: Trials
    chosen: Choice
    kept: Mapping[str, str] = field(default_factory=dict)
    added: Mapping[str, Candidate] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the effects of the set."""
        return (*self.kept, *self.added)

    @property
    def loss(self) -> float:
        """Return the loss of left-out recordings with the cost of parameters, per recording."""
        return (self.trials.base.total - self.chosen.gain) / self.trials.count

    def more(self, chosen: Choice) -> 'FittedSet':
        """Return the set with the last effect of `chosen` besides."""
        new = chosen.fit.candidates[-1]
        return replace(self, chosen=chosen, added={**self.added, new.effect: new})

    def less(self, name: str) -> 'FittedSet':
        """Return the set without an effect, fitted again."""
        trials, model = self.trials, self.trials.model
        if name in self.kept:
            trials = Trials(model.with_gap(model.gap - model.column(self.kept[name])))
        parts = [one for one in self.chosen.fit.candidates if one.effect != name]
        return FittedSet(
            trials,
            trials.choice(parts),
            {key: value for key, value in self.kept.items() if key != name},
            {key: value for key, value in self.added.items() if key != name},
        )

    def gain(self, name: str) -> tuple[float, float]:
        """Return the loss a recording that an effect takes off, and how clearly (t)."""
        less = self.less(name)
        return less.loss - self.loss, advantage(self.chosen.fit, less.chosen.fit)

    def is_clear(self, t: float) -> bool:
        """Return whether recordings agree on a gain; one recording has none to agree with."""
        return self.trials.count == 1 or t >= ROUNDS.t


def grown(
    one: FittedSet,
    candidates: Sequence[Candidate],
    most: int,
    least: float,
    own: Mapping[Candidate, np.ndarray] = MappingProxyType({}),
) -> list[FittedSet]:
    """
    Add up to `most` effects that take off `least` a recording; return the set with each.

    `own` has the values of candidates to start from; the others start from neutral ones.
    """
    out: list[FittedSet] = []
    while len(out) < most:
        larger = _with_one_more(out[-1] if out else one, candidates, least, own)
        if larger is None:
            break
        out.append(larger)
    return out


def _with_one_more(
    one: FittedSet,
    candidates: Sequence[Candidate],
    least: float,
    own: Mapping[Candidate, np.ndarray],
) -> FittedSet | None:
    more, chosen = [], one.chosen
    for candidate in candidates:
        if candidate.effect in {*one.names, *(c.effect for c in chosen.fit.candidates)}:
            continue
        values = own.get(candidate, [term.neutral for term in candidate.terms])
        start = [*chosen.fit.values, *values]
        more.append(one.trials.choice([*chosen.fit.candidates, candidate], np.array(start)))
    for larger in best_of_each(more, last=True):
        if larger.gain - chosen.gain < least * one.trials.count:
            return None
        if one.is_clear(advantage(larger.fit, chosen.fit)):
            return one.more(larger)
    return None


def pruned(one: FittedSet, least: float) -> list[FittedSet]:
    """
    Take off effects that the set does not need, the least needed first.

    Return the set before and after each of them. Needed is what takes off `least` a recording.
    """
    out = []
    while True:
        gains = {name: one.gain(name) for name in one.names}
        out.append(one)
        weak = [k for k, (gain, t) in gains.items() if gain < least or not one.is_clear(t)]
        if not weak:
            return out
        one = one.less(min(weak, key=lambda name: gains[name]))


def without_constants(one: Candidate) -> Candidate:
    """Return a candidate without its constant: in a set, that goes by the name of an offset."""
    return decidable_part(one, set(constants(one).values()))


def louder(one: Candidate) -> Candidate:
    """Return a candidate that makes no less noise than the model: that is a filter's doing."""
    if one.kind.role != 'sigma':
        return one
    terms = tuple(replace(term, low=max(term.low, term.neutral)) for term in one.terms)
    return replace(one, terms=terms)


def select(
    trials: Trials, candidates: Sequence[Candidate], singles: Sequence[Choice]
) -> Selection:
    """
    Select effects that explain the gap; `singles` has each candidate alone.

    If none is sure, the best single effect is chosen. A pose error is in the set from the
    beginning where poses scatter.
    """
    considered, model = best_of_each(singles), trials.model
    posed = [c for c in candidates if c.kind.role == 'pose']
    posed = posed if model.pose_scatter() > THRESHOLDS.scattered else []
    begin, least = FittedSet(trials, trials.choice(posed)), THRESHOLDS.next_gain
    in_sets = [louder(without_constants(one)) for one in candidates]
    own = {one.fit.candidates[0]: one.fit.values for one in singles}
    largest = [begin, *grown(begin, in_sets, ROUNDS.first, least, own)][-1]
    now = pruned(largest, ROUNDS.kept * least)[-1]
    parts, values = now.chosen.fit.candidates, now.chosen.fit.values
    names = [one.effect for one in parts]
    if len(names) < 2:
        alone = [one for one in considered if one.fit.candidates[0].effect in names]
        first, *_ = [*alone, *considered, Choice(trials.base, 0.0)]
        return Selection(first, tuple(one for one in considered if one is not first))
    rest = list(parts[:-1])
    start = values[: len(values) - len(parts[-1].terms)]
    rivals = [
        trials.choice([*rest, *one.fit.candidates], np.array([*start, *one.fit.values]))
        for one in considered
        if one.fit.candidates[0].effect not in names
    ]
    return Selection(
        now.chosen,
        tuple(sorted(rivals, key=lambda one: -one.gain)),
        trials.choice(rest, start).gain,
    )


def without_each(trials: Trials, chosen: Choice) -> list[Choice]:
    """Return the fits of a set without each of its effects in turn."""
    parts = chosen.fit.candidates
    if len(parts) < 2:
        return [Choice(trials.base, 0.0)] * len(parts)
    return [trials.choice([c for c in parts if c is not part]) for part in parts]


def _oddity(one: Fit) -> float:
    # Penalty for effects far below typical strength, which are less likely than other effects at
    # typical strength.
    cost = 0.0
    for candidate, values in one.parts:
        cost += candidate.kind.doubt
        if len(candidate.terms) == 1 and not candidate.steps:
            term = candidate.terms[0]
            usual = abs(term.nodes[len(term.nodes) // 2][0] - term.neutral)
            size = max(abs(float(values[0]) - term.neutral), 1e-3 * usual)
            cost += THRESHOLDS.weak_cost * max(np.log(usual / size) - np.log(THRESHOLDS.weak), 0.0)
    return cost

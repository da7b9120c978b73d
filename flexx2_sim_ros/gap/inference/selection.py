"""
Forward selection of effects by leave-one-out cross-validation.

Effects are added one at a time. Each step adds the effect that reduces the loss on left-out
recordings most. Then effects that the others make unnecessary are removed. This is stepwise
selection: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2009, section
3.3.2.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS, Thresholds
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.fitting import Fit, fit
from flexx2_sim_ros.gap.inference.model import Model
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

    def __init__(self, model: Model, thresholds: Thresholds = THRESHOLDS) -> None:
        """Fit the base simulator."""
        self.model, self.thresholds = model, thresholds
        self.count = len(model.gap)
        self.base = fit(model, [])
        self.null = float(model.null_loss.sum()) + thresholds.floor * self.count

    def choice(
        self,
        parts: Sequence[Candidate],
        start: np.ndarray | None = None,
        scales: Sequence[float] | None = None,
    ) -> Choice:
        """Fit a candidate set; arguments as for `fit`."""
        one = fit(self.model, parts, start, scales)
        about = self.thresholds
        posed = any(c.kind.role == 'pose' for c in parts)
        terms = len(one.values) + about.pose_terms * posed
        cost = self.count * (about.term_cost * terms + _oddity(one, about))
        return Choice(one, self.base.total - one.total - cost)

    def single(self, candidate: Candidate) -> Choice:
        """Fit one candidate: from nothing, and from a simulated value past a local optimum."""
        tries = [self.choice([candidate])]
        if len(candidate.terms) == 1 and len(candidate.terms[0].nodes) > 1:
            value, _ = candidate.terms[0].nodes[len(candidate.terms[0].nodes) // 2]
            tries.append(
                self.choice([candidate], np.array([value]), self.model.constants.scales_from_value)
            )
        return max(tries, key=_gain)

    def excess(self, chosen: Choice) -> float:
        """Return the excess loss: that of the base simulator above noise alone."""
        return max(self.base.inside - self.null - chosen.fit.pose_loss, 1e-9)


def select(
    trials: Trials,
    candidates: Sequence[Candidate],
    singles: Sequence[Choice],
    tick: Callable[[], None],
) -> Selection:
    """Select effects that explain the gap; `singles` has each candidate alone."""
    about, posed = trials.thresholds, [c for c in candidates if c.kind.role == 'pose']
    considered = _simplest_first(best_of_each(singles), about)
    other = bool(considered) and considered[0].gain >= about.least_gain * trials.count
    usual = about.scattered if other else about.scattered_alone
    scattered = bool(posed) and trials.model.pose_scatter() > usual
    if scattered:
        pose = trials.choice(posed)
        first = Selection(Choice(pose.fit, max(pose.gain, about.gain * trials.count)))
    else:
        first = Selection(considered[0] if considered else Choice(trials.base, 0.0))
        first = Selection(first.chosen, tuple(considered[1:]))
    if first.chosen.gain < about.least_gain * trials.count:
        return first
    own = {one.fit.candidates[0]: one.fit.values for one in singles}
    fraction = about.next_to_scattered if scattered else about.next_fraction
    least = fraction * trials.excess(first.chosen)
    grown = _grow(trials, candidates, first, own, least, tick)
    return grown if scattered else _without_stand_ins(trials, grown, considered)


def best_of_each(choices: Sequence[Choice], last: bool = False) -> list[Choice]:
    """Return the best choice of each first (or last) effect, best first."""
    best: dict[str, Choice] = {}
    for one in sorted(choices, key=lambda c: -c.gain):
        names = [c.effect for c in one.fit.candidates]
        best.setdefault(names[-1 if last else 0], one)
    return list(best.values())


def _simplest_first(considered: Sequence[Choice], about: Thresholds) -> list[Choice]:
    # The best first; of those that are as good, the one with the fewest parameters: a constant
    # bias is an offset, although an amplitude bias has a constant, too.
    good = [one for one in considered if one.gain >= (1 - about.as_good) * considered[0].gain > 0]
    first = min(good, key=lambda one: len(one.fit.values), default=None)
    return sorted(considered, key=lambda one: one is not first)


def _gain(one: Choice) -> float:
    return one.gain


def _grow(
    trials: Trials,
    candidates: Sequence[Candidate],
    first: Selection,
    own: Mapping[Candidate, np.ndarray],
    least: float,
    tick: Callable[[], None],
) -> Selection:
    # Add effects until none adds enough.
    now, excess, about = first, trials.excess(first.chosen), trials.thresholds
    for _ in range(about.most_effects - 1):
        little = trials.base.total - now.chosen.fit.total < about.explained_little * excess
        enough = max(about.next_gain * trials.count, least * (0.5 if little else 1))
        larger = _with_one_more(trials, candidates, now.chosen, own, enough, tick)
        if larger is None:
            break
        now = larger
    return now


def _with_one_more(
    trials: Trials,
    candidates: Sequence[Candidate],
    chosen: Choice,
    own: Mapping[Candidate, np.ndarray],
    enough: float,
    tick: Callable[[], None],
) -> Selection | None:
    taken = {c.effect for c in chosen.fit.candidates}
    more: list[Choice] = []
    for candidate in candidates:
        if candidate.effect not in taken:
            start = np.concatenate([chosen.fit.values, own[candidate]])
            more.append(trials.choice([*chosen.fit.candidates, candidate], start))
            tick()
    if not more:
        return None
    best = max(more, key=_gain)
    if best.gain - chosen.gain < enough:
        best = max(_filters_with_noise(trials, candidates, chosen), key=_gain, default=best)
        if best.gain - chosen.gain < trials.thresholds.filter_gain * enough:
            return None
        more = [best]
    rivals = tuple(c for c in best_of_each(more, last=True) if c is not best)
    return Selection(best, rivals, chosen.gain)


def _filters_with_noise(
    trials: Trials, candidates: Sequence[Candidate], chosen: Choice
) -> list[Choice]:
    # The noise of the base simulator was measured behind the camera's filters. With a filter alone
    # the simulated noise is too low, so filters are tried together with excess noise.
    taken = {c.effect for c in chosen.fit.candidates}
    noise = [c for c in candidates if c.kind.role == 'sigma']
    if not noise or any(one.effect in taken for one in noise):
        return []
    start = np.concatenate([chosen.fit.values, trials.thresholds.filtered])
    return [
        trials.choice([*chosen.fit.candidates, one, *noise], start)
        for one in candidates
        if one.kind.filters and one.effect not in taken
    ]


def _without_stand_ins(
    trials: Trials, grown: Selection, considered: Sequence[Choice]
) -> Selection:
    # Remove effects that the others make unnecessary: an effect that was selected early may only
    # have imitated effects that were selected later.
    chosen = grown.chosen
    while len(chosen.fit.candidates) > 1:
        best = max(without_each(trials, chosen), key=_gain)
        if chosen.gain - best.gain >= trials.thresholds.next_gain * trials.count:
            break
        chosen = best
    if chosen is grown.chosen:
        return grown
    if len(chosen.fit.candidates) > 1:
        return Selection(chosen)
    effect = chosen.fit.candidates[0].effect
    return Selection(chosen, tuple(c for c in considered if c.fit.candidates[0].effect != effect))


def without_each(trials: Trials, chosen: Choice) -> list[Choice]:
    """Return the fits of a set without each of its effects in turn."""
    parts = chosen.fit.candidates
    if len(parts) < 2:
        return [Choice(trials.base, 0.0)] * len(parts)
    return [trials.choice([c for c in parts if c is not part]) for part in parts]


def _oddity(one: Fit, about: Thresholds) -> float:
    # Penalty for effects far below typical strength, which are less likely than other effects at
    # typical strength.
    cost = 0.0
    for candidate, values in one.parts:
        cost += candidate.kind.doubt
        if len(candidate.terms) == 1 and not candidate.steps:
            term = candidate.terms[0]
            usual = abs(term.nodes[len(term.nodes) // 2][0] - term.neutral)
            size = max(abs(float(values[0]) - term.neutral), 1e-3 * usual)
            cost += about.weak_cost * max(np.log(usual / size) - np.log(about.weak), 0.0)
    return cost

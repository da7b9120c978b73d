"""Which effects explain the gap: selection, alternative explanations, the verdict."""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace

from flexx2_sim_ros.gap.calibration.decisions import calibrated
from flexx2_sim_ros.gap.calibration.inference import ROUNDS, THRESHOLDS
from flexx2_sim_ros.gap.data.hidden import Undecided
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.decidable import parted, undecided
from flexx2_sim_ros.gap.inference.disagreement import Disagreement
from flexx2_sim_ros.gap.inference.fitting import Fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.probability import EXPLAINED, judge, Judgement
from flexx2_sim_ros.gap.inference.selection import (
    best_of_each,
    Choice,
    select,
    Trials,
    without_each,
)
from flexx2_sim_ros.gap.inference.support import Support, support_of
import numpy as np


@dataclass(frozen=True)
class Alternative:
    """
    An effect that explains about as much in place of the selected ones in `instead_of`.

    It is the last candidate of `fit`; `confidence` is the probability that it is present.
    """

    fit: Fit
    instead_of: tuple[str, ...]
    confidence: float


@dataclass(frozen=True)
class Decision:
    """
    Which effects explain the gap, and how well.

    * `verdict`: ``none``, ``not_decidable`` (no gap, but this ground truth would hide some
      effects), ``identified``, ``partly`` or ``unknown``.
    * `base`, `chosen`: without any effect; with those chosen (the best found, if the verdict is
      ``unknown``).
    * `confidences`: of each chosen effect, the probability that it is present.
    * `alternatives`: other effects that may be present, best first. In 19 of 20 campaigns they and
      the chosen effects together contain a true one.
    * `considered`: the best variant of each single effect, best first.
    * `excess`: loss of the base simulator minus that of noise alone.
    * `undecided`: effects that this ground truth cannot decide. Those that errors of poses and
      planes look like are not selected; if one of them explains about as much as the effects that
      were found, the verdict is ``unknown`` and ``alternatives`` has them all.
    * `why_refused`: with ``unknown``, why the effects chosen are not named: ``improbable`` or
      ``little`` as in `Judgement`; ``hidden``, as an effect that the ground truth hides explains
      about as much; or ``larger``, as they make the gap larger when they are simulated. Otherwise
      empty.
    * `unlike`: an effect that some recordings have and the others lack; None if it was not looked
      for.
    """

    verdict: str
    base: Fit
    chosen: Fit
    confidences: list[float]
    alternatives: list[Alternative]
    considered: list[Choice]
    excess: float
    undecided: list[Undecided]
    support: Support
    why_refused: str = ''
    unlike: Disagreement | None = None

    @property
    def explains_gap(self) -> bool:
        """Whether the effects chosen explain the gap, or a part of it."""
        return self.verdict in EXPLAINED

    @property
    def accepted(self) -> Fit:
        """Return the fit with the effects if they explain the gap, otherwise without any."""
        return self.chosen if self.explains_gap else self.base

    @property
    def settled(self) -> bool:
        """Return whether it names one cause, or none, and leaves no alternative."""
        if self.explains_gap:
            return not self.alternatives
        return self.verdict == 'none'

    @property
    def finds_gap(self) -> bool:
        """Return whether there is a gap, explained or not."""
        return self.verdict not in ('none', 'not_decidable')

    def refused(self) -> 'Decision':
        """Return the decision for effects that make the gap larger: the first alternatives."""
        alone = {one.fit.candidates[-1].effect: one.fit for one in self.considered}
        rows = zip(self.chosen.candidates, self.confidences, strict=True)
        chosen = [
            Alternative(alone[candidate.effect], (), confidence)
            for candidate, confidence in rows
            if candidate.effect in alone
        ]
        others = [replace(one, instead_of=()) for one in self.alternatives]
        return replace(
            self, verdict='unknown', alternatives=[*chosen, *others], why_refused='larger'
        )


def decide(
    model: Model,
    candidates: Sequence[Candidate],
    tick: Callable[[], None] = lambda: None,
    absorbed: Sequence[Undecided] = (),
    not_seen: Sequence[Undecided] | None = None,
) -> Decision:
    """
    Explain the gap.

    * `absorbed`: effects that the ground truth hides by how it was made, wholly or in part, or
      that its errors look like (`confounded`). Without a finding the verdict is ``not_decidable``.
    * `not_seen`: the result of `undecided`, which does not depend on the gap; computed when left
      out.
    """
    if not_seen is None:
        not_seen = undecided(model, candidates, tick)
    known = {one.effect for one in absorbed}
    hidden = [one for one in not_seen if one.confounded]
    seen = {one.effect for one in hidden}
    hidden += [one for one in absorbed if one.confounded and one.effect not in seen]
    covered = [one for one in not_seen if not one.confounded and one.effect not in known]
    absorbed = [*(one for one in absorbed if not one.confounded), *covered]
    names = {one.effect for one in hidden}
    candidates, open_ones = parted(candidates, names)
    trials = Trials(model)
    singles = []
    for candidate in candidates:
        singles.append(trials.single(candidate))
        tick()
    considered = best_of_each(singles)
    selection = select(trials, candidates, singles)
    found, excess = selection.chosen, trials.excess(selection.chosen)
    support = support_of(trials, selection, without_each(trials, found), considered)
    said = judge(support, calibrated())
    verdict, refused = said.verdict, said.refused
    if verdict == 'none' and (hidden or absorbed):
        verdict = 'not_decidable'
    chosen = _as_in_catalogue(trials, found)
    settled = {c.effect for c in chosen.fit.candidates} if verdict in EXPLAINED else set()
    others = set(said.alternatives)
    if open_ones and verdict in (*EXPLAINED, 'unknown'):
        more = [*singles, *(trials.single(candidate) for candidate in open_ones)]
        everyone = [*candidates, *open_ones]
        if (
            hidden_could_explain(trials, found, everyone, more, names)
            if verdict in EXPLAINED
            else hidden_would_be_named(trials, everyone, more, names)
        ):
            # The recordings cannot tell the effects found from one that the ground truth hides.
            verdict, refused = 'unknown', 'hidden'
            considered, others = best_of_each(more), others | names
    rivals, instead = selection.rivals, chosen.fit
    if verdict == 'unknown':
        rivals, instead = tuple(considered), trials.base
        others = others or {one.fit.candidates[-1].effect for one in considered[:1]}
    alternatives = [one.fit for one in rivals if one.fit.candidates[-1].effect in others]
    return Decision(
        verdict,
        trials.base,
        chosen.fit,
        [said.effects[c.effect] for c in chosen.fit.candidates],
        [_alternative(one, instead, said) for one in alternatives[: THRESHOLDS.most_alternatives]],
        considered,
        excess,
        [*(one for one in absorbed if one.effect not in settled | names), *hidden],
        support,
        refused,
    )


def with_effects(
    decision: Decision, model: Model, candidates: Sequence[Candidate], values: np.ndarray
) -> Decision:
    """
    Return a decision with `candidates` as its set of effects, and (n,) `values` of their terms.

    Effects that were chosen before keep their probability.
    """
    trials = Trials(model)
    chosen = _as_in_catalogue(trials, trials.choice(candidates, values))
    names = [one.effect for one in decision.chosen.candidates]
    sure = dict(zip(names, decision.confidences, strict=True))
    kept = {one.effect for one in candidates}
    return replace(
        decision,
        chosen=chosen.fit,
        confidences=[sure.get(one.effect, ROUNDS.true) for one in chosen.fit.candidates],
        alternatives=[
            one for one in decision.alternatives if one.fit.candidates[-1].effect not in kept
        ],
        undecided=[one for one in decision.undecided if one.effect not in kept],
    )


def hidden_could_explain(
    trials: Trials,
    found: Choice,
    candidates: Sequence[Candidate],
    singles: Sequence[Choice],
    hidden: Set[str],
) -> bool:
    """
    Return whether an undecided effect explains about as much as the effects found.

    It may do so alone, or in place of some of them in a selection from all `candidates`, which
    include those of the undecided effects, `hidden`. `singles` has each candidate alone.
    """
    enough = THRESHOLDS.alternative * found.gain
    if any(
        one.gain >= enough and {c.effect for c in one.fit.candidates} & hidden for one in singles
    ):
        return True
    best = {c.effect for c in select(trials, candidates, singles).chosen.fit.candidates}
    return bool(best & hidden) and not {c.effect for c in found.fit.candidates} <= best


def hidden_would_be_named(
    trials: Trials, candidates: Sequence[Candidate], singles: Sequence[Choice], hidden: Set[str]
) -> bool:
    """Return whether an undecided effect would be named; as for `hidden_could_explain`."""
    selection = select(trials, candidates, singles)
    found = selection.chosen
    support = support_of(trials, selection, without_each(trials, found), best_of_each(singles))
    named = {c.effect for c in found.fit.candidates} & hidden
    return bool(named) and judge(support, calibrated()).verdict in EXPLAINED


def _as_in_catalogue(trials: Trials, found: Choice) -> Choice:
    # Effects found along the ray are reported in the catalogue's form, along the optical axis.
    parts = found.fit.candidates
    if not any(c.given for c in parts):
        return found
    return trials.choice([c.given or c for c in parts], found.fit.values)


def _alternative(one: Fit, chosen: Fit, said: Judgement) -> Alternative:
    kept = {c.effect for c in one.candidates}
    return Alternative(
        one,
        tuple(c.effect for c in chosen.candidates if c.effect not in kept),
        said.effects.get(one.candidates[-1].effect, 0.0),
    )

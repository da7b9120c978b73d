"""
The expected decision: what the next diagnosis will say after more recordings.

Each explanation in turn is assumed to be true. The gap of a new recording is then the shift of its
features by the explanation, plus what the explanation leaves unexplained in a recording that was
diagnosed. The latter contains noise, and all by which the real camera differs from the
explanation. Those recordings and the new ones are diagnosed together, by the diagnosis's rules.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.effects import of_role, registry
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.data.hidden import Undecided
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue, Column, nuisances
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import SIZE
from flexx2_sim_ros.gap.features.work import Simulator
from flexx2_sim_ros.gap.inference.decidable import decidable_candidates, undecided, unseen
from flexx2_sim_ros.gap.inference.decide import decide, Decision
from flexx2_sim_ros.gap.inference.effects import fitted_effects, table_of
from flexx2_sim_ros.gap.inference.fitting import Fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.selection import Trials
from flexx2_sim_ros.gap.planning.power import noise, wrong_truth
from flexx2_sim_ros.gap.report.reading import Diagnosed
from flexx2_sim_ros.gap.report.text import spaced
import numpy as np
from scipy.special import softmax

_NONE = 'no effect'
_NARROWLY = 6.0  # loss: an effect that gains so much less is e^3 times less likely
_DRAWS = 2
_COMPARED = 6  # effects that are compared with those still possible
_LEAST = 0.05  # less likely explanations are not assumed to be true, if others are likely
Effects = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Explanation:
    """
    What may be the cause of a gap; `name` is for people.

    `effects` has parameters by effect, the one to name first in front; empty if there is none.
    `weight` is how likely it is. `rest` is (R, SIZE) what it leaves of the gap of the recordings,
    in units of the features' scale; NaN where there is none.
    """

    name: str
    effects: Effects
    weight: float
    rest: np.ndarray


def check_open(before: Diagnosed) -> None:
    """
    Check that a diagnosis leaves something open.

    Raises `InputError` when it does not, or lacks a key.
    """
    for key in ('alternatives', 'not_decidable'):
        if key not in before.table:
            raise InputError(
                f'DIAGNOSIS: diagnosis.json: must be as flexx2 gap diagnose writes it, got no '
                f'{shown(key)}'
            )
    left_open = before.table['alternatives'] or before.table['not_decidable']
    if before.verdict == 'identified' and not left_open:
        raise InputError('DIAGNOSIS: must leave something open, got one explanation: check it')
    if not (before.table.get('effects') or left_open):
        raise InputError(
            'DIAGNOSIS: must have alternatives or effects that are not decidable, got verdict '
            f'{shown(before.verdict)} without any'
        )


def _explanations(
    model: Model, decision: Decision, candidates: Sequence[Candidate]
) -> list[Explanation]:
    # The sets of effects that are still possible, as docs/diagnose_your_flexx2.md lists them. Pose
    # errors count as no effect. An explanation is as likely as exp(gain / 2), with the gain in
    # loss of a `Choice`.
    trials = Trials(model)
    sets = [*_found(trials, decision), *_narrowly_rejected(model, decision)]
    base, kept = decision.accepted, table_of(fitted_effects(model, decision.accepted))
    gain = _gain(trials, base)
    hidden = [one.effect for one in decision.undecided]
    if not decision.finds_gap:
        hidden += [name for name in unseen(model, candidates) if name not in hidden]
    sets += [(kept | {name: registry()[name]().settings}, gain, base) for name in hidden]
    sets.append(({}, 0.0, decision.base))
    pose, out = of_role('pose').name, dict[str, tuple[Effects, float, Fit]]()
    for effects, gain, fit in sets:
        # The pose of each recording is fitted in any case, so a pose error looks like no effect.
        camera = {name: values for name, values in effects.items() if name != pose}
        if not any(camera == other for other, *_ in out.values()):
            out.setdefault(' + '.join(map(spaced, camera)) or _NONE, (camera, gain, fit))
    gains = np.array([gain for _, gain, _ in out.values()])
    weights = softmax(gains / 2)
    rests = [fit.residual(model) / np.sqrt(model.scale2) for *_, fit in out.values()]
    return [
        Explanation(name, effects, weight, np.where(model.good, rest, np.nan))
        for (name, (effects, *_)), weight, rest in zip(out.items(), weights, rests, strict=True)
    ]


def _found(trials: Trials, decision: Decision) -> list[tuple[Effects, float, Fit]]:
    # The chosen effects and the alternatives.
    fits = [decision.chosen] if decision.explains_gap else []
    if decision.finds_gap:
        fits += [one.fit for one in decision.alternatives]
    return [(table_of(fitted_effects(trials.model, fit)), _gain(trials, fit), fit) for fit in fits]


def _narrowly_rejected(model: Model, decision: Decision) -> list[tuple[Effects, float, Fit]]:
    # Single effects are compared with each other, not with a set of effects.
    if not decision.finds_gap or len(decision.accepted.candidates) > 1:
        return []
    best = decision.considered[0].gain
    known = {decision.accepted.candidates[0].effect} if decision.accepted.candidates else set()
    known |= {one.fit.candidates[-1].effect for one in decision.alternatives}
    return [
        (table_of(fitted_effects(model, one.fit)), one.gain, one.fit)
        for one in decision.considered
        if one.gain > max(best - _NARROWLY, 0) and one.fit.candidates[0].effect not in known
    ]


def _gain(trials: Trials, fit: Fit) -> float:
    return trials.choice(fit.candidates, fit.values).gain if fit.candidates else 0.0


@dataclass(frozen=True)
class DiagnosedRecordings:
    """
    The recordings that were diagnosed, and how they are explained.

    * `evidence`: their summaries.
    * `simulator`: how these and new recordings are simulated; its seed is that of draws, too.
    * `catalogue`: the effects that it lacks, and whether the modulation frequencies are known.
    * `hidden`: what the ground truth of the campaign hides.
    * `held`: whether the prior holds the poses; see `Model`.
    * `labels`: effect and label of the candidates that are compared; empty: of all.
    * `standing`: what is still possible.
    """

    evidence: tuple[Evidence, ...]
    simulator: Simulator
    catalogue: tuple[frozenset[str], bool]
    hidden: tuple[Undecided, ...]
    held: bool
    labels: frozenset[tuple[str, str]] = frozenset()
    standing: tuple[Explanation, ...] = ()

    def model(self, new: Sequence[Evidence] = ()) -> Model:
        """Return the model of these recordings and of new ones."""
        told = self.simulator
        every = [*self.evidence, *new]
        return Model(every, told.columns, np.array(told.prior), held=self.held)

    def candidates(self) -> list[Candidate]:
        """Return the candidates that are compared. They cannot be sent to other processes."""
        every = catalogue(*self.catalogue)[1]
        return [one for one in every if not self.labels or (one.effect, one.label) in self.labels]


def what_is_known(before: DiagnosedRecordings) -> DiagnosedRecordings:
    """Diagnose the recordings as before, and return them with what is still possible."""
    model = before.model()
    candidates, absorbed = decidable_candidates(model, before.candidates(), before.hidden)
    decision = decide(model, candidates, absorbed=absorbed)
    standing = _explanations(model, decision, candidates)
    compared = _compared(candidates, standing, decision)
    # The simulations that these candidates need.
    every = [*compared, *(one.given for one in compared if one.given)]
    names = {*nuisances().columns, *(name for one in every for name in one.columns)}
    needed = [column for column in before.simulator.columns if column.name in names]
    own = [Column(one.name, one.effects, few=False) for one in standing if one.effects]
    index = [model.index[column.name] for column in needed]
    blank = np.zeros((len(own), SIZE), np.float32)
    return replace(
        before,
        evidence=tuple(
            replace(one, columns=np.concatenate([one.columns[index], blank]))
            for one in model.evidence
        ),
        simulator=replace(before.simulator, columns=(*needed, *own)),
        labels=frozenset((one.effect, one.label) for one in compared),
        standing=tuple(standing),
    )


def expect(
    known: DiagnosedRecordings, pairs: Sequence[Sequence[Evidence]], fitted: bool
) -> dict[str, float]:
    """
    Return how probable a `right`, a `wrong` and an `undecided` decision is after new recordings.

    `pairs` has each new set-up, simulated twice with different random numbers. `fitted`: planes
    are fitted to the new recordings. What is `undecided` leaves something open.
    """
    new = [one for pair in pairs for one in pair]
    model = known.model(new)
    candidates, absorbed = decidable_candidates(model, known.candidates(), known.hidden)
    not_seen = undecided(model, candidates)
    right = wrong = total = 0.0
    least = min(_LEAST, max(one.weight for one in known.standing) / 2)
    for one in known.standing:
        if one.weight < least:
            continue
        total += one.weight
        for draw in range(_DRAWS):
            rng = np.random.default_rng([known.simulator.seed, draw])
            gap = _gap(model, one, len(new), fitted, rng)
            decision = decide(
                model.with_gap(gap), candidates, absorbed=absorbed, not_seen=not_seen
            )
            if decision.settled:
                names = [c.effect for c in decision.chosen.candidates if decision.explains_gap]
                correct = names[:1] == list(one.effects)[:1]
                right += one.weight / _DRAWS * correct
                wrong += one.weight / _DRAWS * (not correct)
    right, wrong = right / total, wrong / total
    return {'right': right, 'wrong': wrong, 'undecided': max(1 - right - wrong, 0.0)}


def _gap(
    model: Model, assumed: Explanation, count: int, fitted: bool, rng: np.random.Generator
) -> np.ndarray:
    # (R, SIZE) gap if an explanation is true; the last ``count`` recordings are new.
    first = len(model.gap) - count
    gap = noise(model, rng)
    chosen = rng.integers(len(assumed.rest), size=count)
    rest = assumed.rest[chosen] * np.sqrt(model.scale2[first:])
    gap[first:] = np.where(np.isfinite(rest), rest, gap[first:])
    gap[first:] += wrong_truth(model, fitted, rng)[first:]
    if assumed.effects:
        # Each set-up was simulated twice. The shift comes from the other simulation, so that its
        # noise is not that of the fit.
        pairs = model.column(assumed.name)[first:].reshape(-1, 2, SIZE)
        gap[first:] += pairs[:, ::-1].reshape(count, SIZE)
    gap[:first] = model.gap[:first]
    return gap


def _compared(
    candidates: Sequence[Candidate], standing: Sequence[Explanation], decision: Decision
) -> list[Candidate]:
    # The best variant of each effect that explains the gap best. Of each other effect that is
    # still possible the first variant, and the best one where the diagnosis has compared them.
    best = [one.fit.candidates[0] for one in decision.considered]
    possible = {name for one in standing for name in one.effects}
    chosen = [one for i, one in enumerate(best) if i < _COMPARED or one.effect in possible]
    others = possible - {one.effect for one in best[:_COMPARED]}
    chosen += [next(one for one in candidates if one.effect == name) for name in others]
    labels = {(one.effect, one.label) for one in chosen}
    return [one for one in candidates if (one.effect, one.label) in labels]

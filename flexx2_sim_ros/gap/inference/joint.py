"""
A set of effects, fitted around the simulation that has them: what to change, to add, to take off.

Features do not add up: a filter hides noise, and lost pixels hide what they would have shown. So
the columns are simulated again around the set: each number a step less and a step more, the set
without each effect, and each other effect besides. The steps are those of Gauss and Newton.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.calibration.inference import ROUNDS
from flexx2_sim_ros.gap.features.catalogue import Candidate, CandidateTerm, Column
from flexx2_sim_ros.gap.inference.effects import fitted_effects, held_out_effects, of_camera
from flexx2_sim_ros.gap.inference.fitting import nuisances_of
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.selection import FittedSet, grown, pruned, Trials
import numpy as np

Table = dict[str, dict[str, Any]]
Parts = Sequence[tuple[Candidate, np.ndarray]]  # effects with the values of their terms


@dataclass(frozen=True)
class Member:
    """
    An effect of the set.

    `candidate` has its numbers, as steps from those of the set, or is None where none is free.
    `without` is the name of the column of the set without it.
    """

    name: str
    candidate: Candidate | None
    without: str


@dataclass(frozen=True)
class Proposal:
    """
    What a round could make of a set.

    * `effects`: settings by effect.
    * `without`: (R,) the same, fitted without each recording.
    * `motions`: (6 + 3 P,) where each recording's camera and planes are then.
    * `sigma`: relative error of the base sigma_z, of all rounds together.
    * `loss`: on left-out recordings, with the cost of parameters; per recording.
    * `forms`: each effect as it is in the catalogue.
    * `fitted`: the set with its numbers free, and the one around which it was fitted; None where
      it is not as it was fitted.
    """

    effects: Table
    without: list[Table]
    motions: list[np.ndarray]
    sigma: float
    loss: float
    forms: dict[str, Candidate]
    fitted: 'tuple[FittedSet, Proposal] | None' = None

    def less(self, name: str) -> list['Proposal']:
        """Return the set without an effect: the others as they are, and fitted again."""
        left = {key: own for key, own in self.effects.items() if key != name}
        without = [{key: own[key] for key in left} for own in self.without]
        as_they_are = replace(self, effects=left, without=without)
        if not self.fitted:
            return [as_they_are]
        one, now = self.fitted
        less = one.less(name)
        as_they_are = replace(as_they_are, fitted=(less, now))
        return [as_they_are, _proposal(less, now)]


def around(
    effects: Mapping[str, Mapping[str, Any]], candidates: Sequence[Candidate]
) -> tuple[list[Column], list[Member]]:
    """
    Return what to simulate of a set of effects, and what is free in it.

    `effects` has settings by effect; the catalogue says the bounds of numbers.
    """
    columns, members = [], []
    for name, settings in effects.items():
        own, member = _around(name, dict(settings), candidates)
        columns += own
        members.append(member)
    return columns, members


def proposals(
    model: Model,
    now: Proposal,
    members: Sequence[Member],
    candidates: Sequence[Candidate],
    begin: Parts = (),
) -> list[Proposal]:
    """
    Fit a set's numbers again, add what explains more, and take off what explains nothing.

    Return the set as it is, with new numbers, with one more effect after the other, and then with
    one less after the other. `model` has the recordings beside the simulation with the set `now`,
    `members` is as from `around`, and `candidates` are other effects. `begin` are effects that are
    in the set from the beginning, with values to start from; a pose error among them stays.
    """
    wide = model.widened(ROUNDS.scale)
    trials = Trials(wide.carrying({one.name: one.without for one in members}))
    posed = [one for one, _ in begin if one.kind.role == 'pose']
    new = {one.effect: one for one, _ in begin if one not in posed}
    state = FittedSet(trials, trials.choice(posed), {one.name: one.without for one in members})
    as_it_is = _proposal(state, now)
    as_it_is = replace(as_it_is, effects=now.effects, without=now.without)
    out = []
    steps = [one.candidate for one in members if one.candidate]
    if steps or new:
        values = [value for _, own in begin for value in own]
        start = [*values, *(term.neutral for one in steps for term in one.terms)]
        parts = [*(one for one, _ in begin), *steps]
        state = replace(state, chosen=trials.choice(parts, np.array(start)), added=new)
        as_it_is = replace(as_it_is, fitted=(state, now))
        out.append(_proposal(state, now))
    most = ROUNDS.added if members else ROUNDS.first
    larger = grown(state, candidates, most, ROUNDS.gain)
    _, *smaller = pruned([state, *larger][-1], ROUNDS.kept * ROUNDS.gain)
    return [as_it_is, *out, *(_proposal(one, now) for one in (*larger, *smaller))]


def nothing(model: Model) -> Proposal:
    """Return the empty set."""
    fit = Trials(model).base
    motions = model.own.found(fit.nuisances)
    return Proposal({}, [{}] * len(motions), motions, 0.0, np.inf, {})


def _proposal(one: FittedSet, now: Proposal) -> Proposal:
    model, fit = one.trials.model, one.chosen.fit
    kept = {name: now.effects[name] for name in one.kept}
    return Proposal(
        {**kept, **of_camera(fitted_effects(model, fit))},
        [{**kept, **of_camera(own)} for own in held_out_effects(model, fit)],
        # Poses are as sure as ever: only what effects do is uncertain by their form.
        model.own.found(nuisances_of(model.widened(1 / ROUNDS.scale), fit)),
        (1 + now.sigma) * (1 + fit.sigma) - 1,
        one.loss,
        {name: now.forms[name] for name in one.kept}
        | {name: new.given or new for name, new in one.added.items()},
        fitted=(one, now),
    )


def _around(
    name: str, settings: dict[str, Any], candidates: Sequence[Candidate]
) -> tuple[list[Column], Member]:
    kind = registry()[name]
    gone = Column(f'{name}: without', {}, few=False, without=(name,))
    limits = {one.name: (one.low, one.high) for one in kind.parameters()}
    free: dict[str, CandidateTerm] = {}
    numbers = [key for key, value in settings.items() if isinstance(value, float)]
    shaped = any(key in settings for key in kind.tables() if key not in numbers)
    terms = {t.name: t for c in candidates if c.effect == name for t in c.terms}
    if shaped:
        terms = {}
    columns = [gone]
    names = [key for key in numbers if key in terms] or ['strength'] * (not kind.lattice)
    for key in names:
        if key == kind.lattice:
            continue
        value = float(settings.get(key, 1.0))
        low, high = limits.get(key) or (terms[key].low, terms[key].high)
        if key in terms:
            # A number may already lie beyond those that are looked for: of a lens it can.
            low, high = (
                max(low, min(terms[key].low, value)),
                min(high, max(terms[key].high, value)),
            )
        usual = abs(terms[key].nodes[-1][0] - terms[key].neutral) if key in terms else 1.0
        neutral = terms[key].neutral if key in terms else 0.0
        size = max(ROUNDS.step * abs(value - neutral), ROUNDS.least_step * usual)
        nodes = []
        for sign in (-1, 1):
            there = float(np.clip(value + sign * size, low, high))
            if there == value:
                continue
            column = Column(
                f'{name}: {key} {"more" if sign > 0 else "less"}',
                {name: {**settings, key: there}},
                few=False,
                without=(name,),
            )
            columns.append(column)
            nodes.append((there - value, column.name))
        if nodes:
            reach = ROUNDS.reach * size
            free[key] = CandidateTerm(
                key, tuple(nodes), max(low - value, -reach), min(high - value, reach)
            )
    if not free:
        return columns, Member(name, None, gone.name)

    def build(values: tuple[float, ...]) -> dict[str, Any]:
        moved = {
            key: float(settings.get(key, 1.0)) + step
            for key, step in zip(free, values, strict=True)
        }
        return {**settings, **moved}

    candidate = Candidate(name, '', tuple(free.values()), build, kind=kind, steps=True)
    return columns, Member(name, candidate, gone.name)

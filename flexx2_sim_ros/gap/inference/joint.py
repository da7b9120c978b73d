"""
A set of effects, fitted around the simulation that has them: what to change, to add, to take off.

Features do not add up: a filter hides noise, and lost pixels hide what they would have shown. So
the columns are simulated again around the set: each number a step less and a step more, the set
without each effect, and each other effect besides. The steps are those of Gauss and Newton.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.calibration.inference import ROUNDS
from flexx2_sim_ros.gap.features.catalogue import Candidate, CandidateTerm, Column
from flexx2_sim_ros.gap.inference.effects import fitted_effects, held_out_effects, of_camera
from flexx2_sim_ros.gap.inference.fitting import nuisances_of
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.selection import best_of_each, Choice, Trials
from flexx2_sim_ros.gap.inference.uncertainty import advantage
import numpy as np

Table = dict[str, dict[str, Any]]


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
class Begin:
    """
    What of the catalogue is in a set from the beginning.

    `found` are effects that were found before, `values` (n,) of their terms; `posed` a pose error
    that the recordings have in common, if there is one.
    """

    found: tuple[Candidate, ...] = ()
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    posed: tuple[Candidate, ...] = ()


NOTHING = Begin()


@dataclass(frozen=True)
class Proposal:
    """
    What a round could make of a set; `label` says what was done.

    * `effects`: settings by effect.
    * `without`: (R,) the same, fitted without each recording.
    * `motions`: (6 + 3 P,) where each recording's camera and planes are then.
    * `sigma`: relative error of the base sigma_z.
    * `loss`: on left-out recordings, with the cost of parameters; per recording.
    * `forms`: each effect as it is in the catalogue.
    * `gains`: the loss a recording that each effect takes off beside the others, and how clearly
      (t over recordings); empty where that was not measured.
    """

    effects: Table
    without: list[Table]
    motions: list[np.ndarray]
    sigma: float
    loss: float
    forms: dict[str, Candidate]
    gains: dict[str, tuple[float, float]] = field(default_factory=dict)
    label: str = ''


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
    begin: Begin = NOTHING,
) -> list[Proposal]:
    """
    Fit a set's numbers again, add what explains more, and take off what explains nothing.

    Return the set as it is, with new numbers, with one more effect after the other, and then with
    one less after the other. `model` has the recordings beside the simulation with the set `now`,
    `members` is as from `around`, and `candidates` are other effects.
    """
    wide = model.widened(ROUNDS.scale)
    trials = Trials(wide.carrying({one.name: one.without for one in members}))
    kept = {one.name: one.without for one in members}
    state = _State(trials, trials.choice(begin.posed), kept, {})
    as_it_is = state.proposal(now, 'as it is')
    out = [replace(as_it_is, effects=now.effects, without=now.without)]
    steps = [one.candidate for one in members if one.candidate]
    if begin.found or steps:
        start = [*begin.values, *(term.neutral for one in steps for term in one.terms)]
        chosen = trials.choice([*begin.posed, *begin.found, *steps], np.array(start))
        state = replace(state, chosen=chosen, added={one.effect: one for one in begin.found})
        out.append(state.proposal(now, 'new numbers'))
    for _ in range(ROUNDS.added if members else ROUNDS.first):
        larger = _with_one_more(state, candidates)
        if larger is None:
            break
        state = larger
        name = list(state.added)[-1]
        out.append(state.proposal(now, f'with {name}'))
    known: dict[str, tuple[float, float]] = {}
    while state.names:
        gains = {name: state.gain(name) for name in state.names}
        out[-1], known = replace(out[-1], gains=gains), known or gains
        weak = [name for name, (gain, t) in gains.items() if gain < ROUNDS.kept or t < ROUNDS.t]
        if not weak:
            break
        weakest = min(weak, key=lambda name: gains[name])
        state = state.less(weakest)
        out.append(state.proposal(now, f'without {weakest}'))
    return [one if one.gains else replace(one, gains=known) for one in out]


def nothing(model: Model) -> Proposal:
    """Return the empty set."""
    fit = Trials(model).base
    motions = model.own.found(fit.nuisances)
    return Proposal({}, [{}] * len(motions), motions, fit.sigma, np.inf, {})


@dataclass(frozen=True)
class _State:
    # A set as fitted: what was chosen, the columns without each effect of the base simulator that
    # is kept, and the effects that are new.
    trials: Trials
    chosen: Choice
    kept: dict[str, str]
    added: dict[str, Candidate]

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.kept, *self.added)

    @property
    def loss(self) -> float:
        return (self.trials.base.total - self.chosen.gain) / self.trials.count

    def more(self, chosen: Choice) -> '_State':
        new = chosen.fit.candidates[-1]
        return replace(self, chosen=chosen, added={**self.added, new.effect: new})

    def less(self, name: str) -> '_State':
        trials, model = self.trials, self.trials.model
        if name in self.kept:
            model = model.with_gap(model.gap - model.column(self.kept[name]))
            trials = Trials(model, trials.thresholds)
        parts = [one for one in self.chosen.fit.candidates if one.effect != name]
        return _State(
            trials,
            trials.choice(parts),
            {key: value for key, value in self.kept.items() if key != name},
            {key: value for key, value in self.added.items() if key != name},
        )

    def gain(self, name: str) -> tuple[float, float]:
        # The loss a recording that an effect takes off beside the others, and how clearly.
        less = self.less(name)
        return less.loss - self.loss, advantage(self.chosen.fit, less.chosen.fit)

    def proposal(self, now: Proposal, label: str) -> Proposal:
        model, fit = self.trials.model, self.chosen.fit
        kept = {name: now.effects[name] for name in self.kept}
        return Proposal(
            {**kept, **of_camera(fitted_effects(model, fit))},
            [{**kept, **of_camera(own)} for own in held_out_effects(model, fit)],
            # Poses are as sure as ever: only what effects do is uncertain by their form.
            model.own.found(nuisances_of(model.widened(1 / ROUNDS.scale), fit)),
            fit.sigma,
            self.loss,
            {name: now.forms[name] for name in self.kept}
            | {name: one.given or one for name, one in self.added.items()},
            label=label,
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


def _with_one_more(state: _State, candidates: Sequence[Candidate]) -> _State | None:
    more, chosen = [], state.chosen
    for candidate in candidates:
        if candidate.effect in state.names or candidate.kind.role == 'pose':
            continue
        start = [*chosen.fit.values, *(term.neutral for term in candidate.terms)]
        more.append(state.trials.choice([*chosen.fit.candidates, candidate], np.array(start)))
    for one in best_of_each(more, last=True):
        if one.gain - chosen.gain < ROUNDS.gain * state.trials.count:
            return None
        if advantage(one.fit, chosen.fit) >= ROUNDS.t:
            return state.more(one)
    return None

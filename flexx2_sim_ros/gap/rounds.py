"""Fit the effects of a diagnosis together, around the simulation that has them, in rounds."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
import logging
import math
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.gap.calibration.inference import ROUNDS
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.given import Table as Given
from flexx2_sim_ros.gap.features.catalogue import Candidate, nuisances
from flexx2_sim_ros.gap.features.confirm import how_far
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.forms.calibrating import calibrate_named
from flexx2_sim_ros.gap.forms.looked import Simulator
from flexx2_sim_ros.gap.inference.joint import around, nothing, Parts, Proposal, proposals, Table
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.selection import louder, without_constants
from flexx2_sim_ros.gap.work import noisier, Simulations, summarise_all
from flexx2_sim_ros.jobs import bind, Map
import numpy as np

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class ExplainedSet:
    """
    A set of effects, and how near it comes.

    * `proposal`: the set; its sigma is that of all rounds together.
    * `far`: (R, 4) how far each recording is from its simulation with values that were fitted
      without it; see `how_far`.
    """

    proposal: Proposal
    far: np.ndarray

    @property
    def apart(self) -> np.ndarray:
        """Return how far each recording is, noise included, (R,)."""
        return _whole(self.far)


@dataclass(frozen=True)
class Campaign:
    """
    The recordings of a campaign and how they are simulated.

    `folder` is for errors; `mapped` is a map as from `workers`. `step` is called after each job of
    a recording. `posed` is a pose error that the recordings have in common, if there is one;
    `held` is that of `Model`.
    """

    folder: str
    found: Sequence[Found]
    candidates: Sequence[Candidate]
    simulations: Simulations
    mapped: Map
    step: Callable[[], None] = lambda: None
    posed: Parts = ()
    held: bool = False

    def judged(self, some: Sequence[Proposal]) -> list[ExplainedSet]:
        """Simulate several proposals."""
        one = self.simulations
        jobs = [
            (found, [(p.motions[r], p.without[r], p.sigma) for p in some])
            for r, found in enumerate(self.found)
        ]
        work = bind(_far, profile=one.profile, seed=one.seed, known=one.known)
        apart = np.array(self.mapped(work, jobs, self.step))
        return [ExplainedSet(p, apart[:, i]) for i, p in enumerate(some)]

    def proposed(self, best: Proposal) -> list[Proposal]:
        """Return what a round could make of a set; see `joint.proposals`."""
        one, now = self.simulations, best.effects
        others = [c for c in one.columns if not set(c.effects) & set(now)]
        own, members = around(now, self.candidates)
        always = [c for c in one.columns if c.name in nuisances().columns]
        columns = list({c.name: c for c in (*always, *others, *own)}.values())
        found, profile = noisier(self.found, one.profile, 1 + best.sigma)
        here = replace(one, profile=profile, columns=columns, known={**(one.known or {}), **now})
        there = best.motions
        _, evidence, _ = summarise_all(
            self.folder, found, [], here, self.mapped, self.step, motions=there
        )
        model = Model(evidence, columns, np.array(one.prior), held=self.held)
        left = [c for c in self.candidates if c.effect not in now]
        some = proposals(model, best, members, left, self.posed)
        return [replace(p, sigma=(1 + best.sigma) * (1 + p.sigma) - 1) for p in some]

    def formed(self, best: Proposal) -> list[Proposal]:
        """Return a set with the forms that its recordings show, if there are any."""
        one = self.simulations
        simulator = Simulator(self.mapped, one.profile, one.known or {}, one.seed, one.prior)
        forms = calibrate_named(
            self.found,
            best.motions,
            parse_effects(best.effects),
            [parse_effects(own) for own in best.without],
            simulator,
            lambda: None,
        )
        if forms is None or not forms.taken:
            return []
        motions = [looked.samples.motion for looked in forms.explained.looked]
        effects, without = forms.explained.effects, list(forms.explained.now)
        return [replace(best, effects=effects, without=without, motions=motions, label='forms')]

    def taking_off(self, best: ExplainedSet) -> dict[str, np.ndarray]:
        """Return by how much recordings are farther apart without each effect, (R, 4)."""
        some = [_without(best.proposal, [name]) for name in best.proposal.effects]
        judged = zip(best.proposal.effects, self.judged(some), strict=True)
        return {name: one.far - best.far for name, one in judged}


def explain(campaign: Campaign, model: Model, begin: Parts) -> Proposal:
    """
    Return the set of effects that explains the recordings.

    `model` has the recordings beside the simulation without any effect, `begin` is what was found
    so far.
    """
    candidates = [
        louder(without_constants(one)) for one in campaign.candidates if one.kind.role != 'pose'
    ]
    posed = [(one, values) for one, values in begin if one.kind.role == 'pose']
    campaign = replace(campaign, candidates=candidates, posed=posed)
    return refine(campaign, proposals(model, nothing(model), [], candidates, begin)[1:])


def refine(campaign: Campaign, begin: Sequence[Proposal]) -> Proposal:
    """
    Fit a set of effects again, add to it and take off it, as long as simulations come nearer.

    Each round simulates the recordings with the set and fits steps from it. Of the sets that this
    gives, the one counts whose simulation is nearest to the recordings, jumps included; so it does
    of those in `begin`.
    """
    visited, tried, some = [], set[str](), begin
    for _ in range(ROUNDS.most):
        now = _nearest(campaign.judged(some))
        if set(now.proposal.effects) - tried:
            tried |= set(now.proposal.effects)
            forms = campaign.judged(campaign.formed(now.proposal))
            now = _nearest([now, *forms], 0.0)
        visited.append(now)
        least = min(one.apart.mean() for one in visited)
        if len(visited) > 1 and now.proposal.effects == visited[-2].proposal.effects:
            break
        if now.apart.mean() > (1 + ROUNDS.as_near) * least:
            break
        some = campaign.proposed(now.proposal)
    best = _nearest(visited, ROUNDS.nearer)
    return needed(best, campaign.taking_off(best))


def _whole(far: np.ndarray) -> np.ndarray:
    # (R,) distance and noise, of (R, 4) as from `how_far`.
    return far[:, 0] + far[:, 3]


def surely(rise: np.ndarray) -> float:
    """Return how clearly a distance rises: Student's t over recordings, 0 with one."""
    if len(rise) < 2:
        return 0.0
    return float(rise.mean() / (rise.std(ddof=1) / math.sqrt(len(rise)) + 1e-9))


def needed(best: ExplainedSet, rises: Mapping[str, np.ndarray]) -> Proposal:
    """
    Return a set without the effects that it does not need, the largest rise first.

    Simulations have to show that an effect is needed, by `rises` as from `Campaign.taking_off`,
    and features as well, unless the effect takes off much of what is left.
    """
    left, proposal = best.apart.mean(), best.proposal
    kept = []
    for name in sorted(rises, key=lambda name: -rises[name][:, 0].mean()):
        rise, (gain, t) = _whole(rises[name]), proposal.gains.get(name, (0.0, 0.0))
        shown = surely(rise)
        _LOG.debug('%s: rise %.2f t %.1f, gain %.2f t %.1f', name, rise.mean(), shown, gain, t)
        both = gain >= ROUNDS.kept * ROUNDS.gain and t >= ROUNDS.t and shown + t >= ROUNDS.both
        if shown >= ROUNDS.t and (both or rise.mean() >= ROUNDS.large * left):
            kept.append(name)
    less = _without(proposal, set(rises) - set(kept))
    return replace(less, effects={name: less.effects[name] for name in kept})


def _without(one: Proposal, names: Collection[str]) -> Proposal:
    def left(table: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in table.items() if name not in names}

    without = [left(own) for own in one.without]
    label = f'less {", ".join(names)}'
    return replace(one, effects=left(one.effects), without=without, label=label)


def _nearest(some: Sequence[ExplainedSet], within: float = ROUNDS.as_near) -> ExplainedSet:
    for one in some:
        _LOG.debug(
            '%.2f loss %.2f %s: %s',
            one.apart.mean(),
            one.proposal.loss,
            one.proposal.label,
            ', '.join(one.proposal.effects),
        )
    least = min(one.apart.mean() for one in some)
    near = [one for one in some if one.apart.mean() <= (1 + within) * least]
    # What more effects explain has to bring the simulation nearer as well.
    near = [one for one in near if not any(_nearer_part(other, one) for other in near)]
    return min(near, key=lambda one: one.proposal.loss + ROUNDS.gain * len(one.proposal.effects))


def _nearer_part(one: ExplainedSet, whole: ExplainedSet) -> bool:
    part = set(one.proposal.effects) < set(whole.proposal.effects)
    return part and one.apart.mean() < whole.apart.mean()


def _far(
    job: tuple[Found, list[tuple[np.ndarray, Table, float]]],
    profile: Profile | None,
    seed: int,
    known: Given | None,
) -> list[list[float]]:
    found, some = job
    out = []
    for motion, effects, sigma in some:
        (noisy,), own = noisier([found], profile, 1 + sigma)
        scene = PlacedScene.at(read(noisy, own, known), motion)
        out.append(how_far(scene, effects, seed))
    return out

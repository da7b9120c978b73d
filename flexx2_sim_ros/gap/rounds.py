"""Fit the effects of a diagnosis together, around the simulation that has them, in rounds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.effects.hypothesis import AS_SEARCHED
from flexx2_sim_ros.gap.calibration.inference import ROUNDS
from flexx2_sim_ros.gap.data.campaign import Found, read
from flexx2_sim_ros.gap.data.given import Table as Given
from flexx2_sim_ros.gap.features.catalogue import Candidate, nuisances
from flexx2_sim_ros.gap.features.confirm import far_in_all
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.features.work import noisier, Simulator, summarise_all
from flexx2_sim_ros.gap.forms.calibrating import calibrate_named
from flexx2_sim_ros.gap.inference.joint import around, nothing, Parts, Proposal, proposals, Table
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.own_errors import OwnErrors
from flexx2_sim_ros.gap.inference.selection import louder, without_constants
from flexx2_sim_ros.gap.inference.uncertainty import t_of
import numpy as np


@dataclass(frozen=True)
class ExplainedSet:
    """
    A set of effects, and how near it comes.

    The sigma of `proposal` is that of all rounds together. `apart` is (R,) how far each recording
    is from its simulation with values that were fitted without it, noise included, and what its
    camera and planes cost where they are: poses take up a bias, but not for nothing.
    """

    proposal: Proposal
    apart: np.ndarray


@dataclass(frozen=True)
class Campaign:
    """
    The recordings of a campaign and how they are simulated.

    `folder` is for errors. `step` is called after each job of a recording. `own` says what it
    costs to move cameras and planes. `posed` is a pose error that the recordings have in common,
    if there is one; `held` is that of `Model`.
    """

    folder: str
    found: Sequence[Found]
    candidates: Sequence[Candidate]
    simulator: Simulator
    own: OwnErrors
    step: Callable[[], None] = lambda: None
    posed: Parts = ()
    held: bool = False

    def judged(self, some: Sequence[Proposal]) -> list[ExplainedSet]:
        """Simulate several proposals."""
        jobs = [
            (found, [(p.motions[r], p.without[r], p.sigma) for p in some])
            for r, found in enumerate(self.found)
        ]
        far = np.array(self.simulator.run(_far, jobs, self.step))
        return [ExplainedSet(p, far[:, i] + self.own.cost(p.motions)) for i, p in enumerate(some)]

    def proposed(self, best: Proposal) -> list[Proposal]:
        """Return what a round could make of a set; see `joint.proposals`."""
        one, now = self.simulator, best.effects
        others = [c for c in one.columns if not set(c.effects) & set(now)]
        own, members = around(now, self.candidates)
        always = [c for c in one.columns if c.name in nuisances().columns]
        columns = list({c.name: c for c in (*always, *others, *own)}.values())
        found, profile = noisier(self.found, one.profile, 1 + best.sigma)
        here = replace(one, profile=profile, columns=columns, known={**one.known, **now})
        there = best.motions
        _, evidence, _ = summarise_all(self.folder, found, [], here, self.step, there)
        model = Model(evidence, columns, np.array(one.prior), held=self.held)
        left = [c for c in self.candidates if c.effect not in now]
        return proposals(model, best, members, left, self.posed)

    def formed(self, best: Proposal) -> list[Proposal]:
        """Return a set with the forms that its recordings show, if there are any."""
        forms = calibrate_named(
            self.found,
            best.motions,
            parse_effects(best.effects),
            [parse_effects(own) for own in best.without],
            self.simulator,
            lambda: None,
        )
        if forms is None or not forms.taken:
            return []
        found = forms.explained
        motions = [looked.samples.motion for looked in found.looked]
        formed = replace(best, effects=found.effects, without=found.now, motions=motions)
        return [replace(formed, fitted=None)]


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
    first = proposals(model, nothing(model), [], candidates, begin)[1:]
    return refine(campaign, [*first, *_together(model, as_searched(candidates))])


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
    return needed(campaign, _nearest(visited, ROUNDS.nearer)).proposal


def as_searched(candidates: Sequence[Candidate]) -> dict[str, Candidate]:
    """Return the biases that were found before anything was simulated, as large as they are."""
    return {one.effect: one for one in candidates if one.label == AS_SEARCHED}


def _together(model: Model, forms: dict[str, Candidate]) -> list[Proposal]:
    # Each alone is in the catalogue, but features that are far off do not add up.
    if len(forms) < 2:
        return []
    effects = {
        name: dict(form.build(tuple(term.nodes[0][0] for term in form.terms)))
        for name, form in forms.items()
    }
    motions = model.own.found(np.zeros((len(model.gap), model.own.count)))
    without = [effects] * len(motions)
    return [Proposal(effects, without, motions, 0.0, np.inf, forms)]


def unneeded(rises: Mapping[str, np.ndarray], left: float) -> list[str]:
    """
    Return the effects that a set does not need, the least needed first.

    `rises` is by how much recordings are farther apart without each effect, (R,): surely, and by a
    part of the mean distance that is `left`.
    """
    means = {name: float(rise.mean()) for name, rise in rises.items()}
    weak = [
        name
        for name, mean in means.items()
        if mean < ROUNDS.least * left or t_of(rises[name]) < ROUNDS.sure
    ]
    return sorted(weak, key=means.__getitem__)


def needed(campaign: Campaign, best: ExplainedSet) -> ExplainedSet:
    """
    Take effects off a set that it does not need, one after the other; see `unneeded`.

    The other effects are as they are then or fitted again, whichever is nearer.
    """
    names = list(best.proposal.effects)
    while names:
        less = {name: best.proposal.less(name) for name in names}
        every = iter(campaign.judged([one for some in less.values() for one in some]))
        judged = {
            name: min((next(every) for _ in some), key=lambda one: one.apart.mean())
            for name, some in less.items()
        }
        rises = {name: one.apart - best.apart for name, one in judged.items()}
        weak = unneeded(rises, float(best.apart.mean()))
        if not weak:
            break
        best, names = judged[weak[0]], weak[1:]
    return best


def _nearest(some: Sequence[ExplainedSet], within: float = ROUNDS.as_near) -> ExplainedSet:
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
) -> list[float]:
    found, some = job
    out = []
    for motion, effects, sigma in some:
        (noisy,), own = noisier([found], profile, 1 + sigma)
        scene = PlacedScene.at(read(noisy, own, known), motion)
        out.append(far_in_all(scene, effects, seed))
    return out

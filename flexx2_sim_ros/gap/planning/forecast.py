"""
The expected decision: what the next diagnosis will say after more recordings.

Each explanation in turn is assumed to be true. The gap of a new recording is then the shift of its
features by the explanation, plus what the explanation leaves unexplained in a recording that was
diagnosed. The latter contains noise, and all by which the real camera differs from the
explanation. Those recordings and the new ones are diagnosed together, by the diagnosis's rules.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.gap.data.given import Table
from flexx2_sim_ros.gap.data.hidden import Hidden
from flexx2_sim_ros.gap.features.catalogue import Candidate, catalogue, Column, nuisances
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import SIZE
from flexx2_sim_ros.gap.inference.decidable import decidable_candidates, undecided
from flexx2_sim_ros.gap.inference.decide import decide, Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.planning.explanations import Explanation, explanations
from flexx2_sim_ros.gap.planning.power import noise, wrong_truth
import numpy as np

_DRAWS = 2
_COMPARED = 6  # effects that are compared with those still possible
_LEAST = 0.05  # less likely explanations are not assumed to be true, if others are likely


@dataclass(frozen=True)
class DiagnosedWith:
    """
    What the recordings were diagnosed with.

    Attributes
    ----------
    profile : Profile
        The camera.
    given : dict
        Effects that were taken as given: parameters by name.
    columns : tuple of Column
        The simulations of each recording.
    without : frozenset of str
        Effects that the catalogue lacks.
    modulation : bool
        Whether the modulation frequencies are known.
    hidden : tuple of Hidden
        What the ground truth of the campaign hides.
    prior : tuple of float
        (6,) standard deviations of pose errors, metres and degrees.
    held : bool
        Whether they hold the poses; see `Model`.
    seed : int
        Seed of the simulations and draws.

    """

    profile: Profile
    given: Table
    columns: tuple[Column, ...]
    without: frozenset[str]
    modulation: bool
    hidden: tuple[Hidden, ...]
    prior: tuple[float, ...]
    held: bool
    seed: int

    def candidates(self) -> list[Candidate]:
        """Return the catalogue. Candidates cannot be sent to other processes."""
        return catalogue(self.without, self.modulation)[1]


@dataclass(frozen=True)
class DiagnosedRecordings:
    """
    The recordings that were diagnosed, and how they are explained.

    Attributes
    ----------
    evidence : tuple of Evidence
        Of the recordings.
    columns : tuple of Column
        Of this evidence and that of new recordings.
    labels : frozenset of tuple of str
        Effect and label of the candidates that are compared.
    standing : tuple of Explanation
        What is still possible.
    source : DiagnosedWith
        What the recordings were diagnosed with.

    """

    evidence: tuple[Evidence, ...]
    columns: tuple[Column, ...]
    labels: frozenset[tuple[str, str]]
    standing: tuple[Explanation, ...]
    source: DiagnosedWith

    def candidates(self) -> list[Candidate]:
        """Return the candidates that are compared."""
        return [one for one in self.source.candidates() if (one.effect, one.label) in self.labels]


@dataclass(frozen=True)
class Expected:
    """
    The expected decision after new recordings.

    Attributes
    ----------
    right, wrong, undecided : float
        Probabilities that it is correct, that it is wrong, and that it leaves something open;
        their sum is 1.

    """

    right: float
    wrong: float
    undecided: float


def what_is_known(model: Model, source: DiagnosedWith) -> DiagnosedRecordings:
    """
    Diagnose the recordings, and return what is still possible.

    Parameters
    ----------
    model : Model
        The recordings.
    source : DiagnosedWith
        What they were diagnosed with.

    """
    candidates, absorbed = decidable_candidates(model, source.candidates(), source.hidden)
    decision = decide(model, candidates, absorbed=absorbed)
    standing = explanations(model, decision, candidates)
    compared = _compared(candidates, standing, decision)
    needed = _columns(source.columns, compared)
    own = [Column(one.name, one.effects, few=False) for one in standing if one.effects]
    index = [model.index[column.name] for column in needed]
    blank = np.zeros((len(own), SIZE), np.float32)
    return DiagnosedRecordings(
        tuple(
            replace(one, columns=np.concatenate([one.columns[index], blank]))
            for one in model.evidence
        ),
        (*needed, *own),
        frozenset((one.effect, one.label) for one in compared),
        tuple(standing),
        source,
    )


def expect(
    known: DiagnosedRecordings, pairs: Sequence[tuple[Evidence, Evidence]], fitted: bool
) -> Expected:
    """
    Return the expected decision when set-ups are recorded twice each.

    Parameters
    ----------
    known : DiagnosedRecordings
        The recordings so far.
    pairs : sequence of tuple of Evidence
        Each new set-up, simulated twice with different random numbers.
    fitted : bool
        Whether planes are fitted to the new recordings.

    """
    new = [one for pair in pairs for one in pair]
    about = known.source
    model = Model([*known.evidence, *new], known.columns, np.array(about.prior), held=about.held)
    candidates, absorbed = decidable_candidates(model, known.candidates(), known.source.hidden)
    not_seen = undecided(model, candidates)
    right = wrong = total = 0.0
    least = min(_LEAST, max(one.weight for one in known.standing) / 2)
    for one in known.standing:
        if one.weight < least:
            continue
        total += one.weight
        for draw in range(_DRAWS):
            rng = np.random.default_rng([known.source.seed, draw])
            gap = _gap(model, one, len(new), fitted, rng)
            decision = decide(
                model.with_gap(gap), candidates, absorbed=absorbed, not_seen=not_seen
            )
            if decision.settled:
                correct = _named(decision) == one.cause
                right += one.weight / _DRAWS * correct
                wrong += one.weight / _DRAWS * (not correct)
    right, wrong = right / total, wrong / total
    return Expected(right, wrong, max(1 - right - wrong, 0.0))


def _gap(
    model: Model, assumed: Explanation, count: int, fitted: bool, rng: np.random.Generator
) -> np.ndarray:
    # (R, SIZE) gap of all recordings, the last ``count`` of which are new, if an explanation is
    # true.
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


def _named(decision: Decision) -> str | None:
    return next((one.effect for one in decision.chosen.candidates if decision.explains_gap), None)


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


def _columns(columns: Sequence[Column], candidates: Sequence[Candidate]) -> list[Column]:
    # The simulations that these candidates need.
    names = set(nuisances().columns)
    for one in candidates:
        for term in (*one.terms, *(one.given.terms if one.given else ())):
            names |= {c if isinstance(c, str) else c.column for _, c in term.nodes}
    return [column for column in columns if column.name in names]

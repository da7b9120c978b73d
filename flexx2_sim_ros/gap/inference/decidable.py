"""
Which effects cannot be decided because errors of the ground truth look the same.

The gap that an effect of typical strength would cause, without noise, is fitted with the possible
errors of the ground truth. The effect is not decidable if too little of the gap is left for a
finding, while an exact ground truth would leave enough. The same test with additional measurements
says which of them would decide it.
"""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace

from flexx2_sim_ros.effects import of_role, registry
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.data.hidden import Undecided
from flexx2_sim_ros.gap.data.pose import NAMES, STEPS
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.data.unknown import PLANE_STEPS
from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.fitting import fit
from flexx2_sim_ros.gap.inference.model import combine, Model
import numpy as np


def undecided(
    model: Model, candidates: Sequence[Candidate], tick: Callable[[], None] = lambda: None
) -> list[Undecided]:
    """
    List the effects that this ground truth leaves undecided, in the order of the catalogue.

    All effects are decidable if no recording gives an accuracy of its ground truth. `tick` is
    called for each candidate.
    """
    covariances = [e.covariance for e in model.evidence]
    inexact = any(e.truth_spread.any() for e in model.evidence)
    if not inexact and all(c is None for c in covariances):
        return []
    exact = [None if c is None else np.zeros_like(c) for c in covariances]
    worst: dict[str, tuple[float, Candidate]] = {}
    confounded = set()
    for candidate in candidates:
        tick()
        shift, least = _typical(model, candidate), _least(model, candidate)
        known = model.as_if(shift, exact, exact=True)
        if float(known.losses(shift).sum()) < least:
            continue  # These recordings would not show it in any case.
        left = _left(model.as_if(shift))
        if left >= least:
            continue
        whole = _left(known)
        absorbed = float(np.clip(1 - left / max(whole, 1e-9), 0, 1))
        if whole < least:
            continue
        if _left(model.as_if(shift, exact=True)) < least:
            confounded.add(candidate.effect)
        if absorbed > worst.get(candidate.effect, (0.0,))[0]:
            worst[candidate.effect] = absorbed, candidate
    return [
        Undecided(
            effect,
            absorbed,
            _settled_by(model, candidate, covariances),
            confounded=effect in confounded,
        )
        for effect, (absorbed, candidate) in worst.items()
    ]


def unseen(model: Model, candidates: Sequence[Candidate]) -> list[str]:
    """
    List the effects that would not make a gap in these recordings.

    At typical strength, without noise, each variant of such an effect leaves less loss than that
    of a gap, after the recordings' own errors are fitted.
    """
    least, most = THRESHOLDS.gap * len(model.gap), dict[str, float]()
    for one in candidates:
        changed = fit(model.as_if(_typical(model, one)), [], scales=GROUND_TRUTH.scales)
        most[one.effect] = max(most.get(one.effect, 0.0), changed.inside)
    return [effect for effect, loss in most.items() if loss < least]


def _least(model: Model, candidate: Candidate) -> float:
    terms = len(candidate.terms) + THRESHOLDS.pose_terms * (candidate.kind.role == 'pose')
    count = max(len(model.gap) - 1, 1)
    return GROUND_TRUTH.margin * count * (THRESHOLDS.gain + THRESHOLDS.term_cost * terms)


def _left(model: Model) -> float:
    # Loss that the recordings' own errors do not explain, without the recording that shows the
    # effect best: a finding must hold on recordings that are left out of its fit.
    one = fit(model, [], scales=GROUND_TRUTH.scales)
    return one.inside - (float(one.loss.max()) if len(one.loss) > 1 else 0.0)


def _typical(model: Model, candidate: Candidate) -> np.ndarray:
    # (R, SIZE) change by the effect at typical strength.
    count = len(model.gap)
    if candidate.kind.role == 'pose':
        usual = {p.name: p.default for p in registry()[candidate.effect].parameters()}
        amounts = np.zeros((count, model.own.count))
        amounts[:, :POSE] = np.array([usual[name] for name in NAMES]) / STEPS
        columns, _ = model.nuisance_columns([], np.zeros((count, 0)))
        return combine(amounts, columns)
    usual = {p.name: p.default for p in candidate.kind.parameters()}
    values = [
        usual.get(term.name) or term.nodes[len(term.nodes) // 2][0] for term in candidate.terms
    ]
    return model.predict([candidate], np.tile(values, (count, 1)))[0]


def _settled_by(
    model: Model, candidate: Candidate, covariances: Sequence[np.ndarray | None]
) -> str:
    # The first measurement with which enough of the effect is left.
    shift, least = _typical(model, candidate), _least(model, candidate)
    about = GROUND_TRUTH
    given = [c for c in covariances if c is not None]
    planes = any(len(c) > POSE for c in given)
    posed = any(c[:POSE, :POSE].any() for c in given)
    for words, possible, measured in (
        ('a tape measure (distance of each plane)', planes, _Measured(offset=about.tape)),
        ('a set square (angles between planes)', planes, _Measured(tilt=about.square)),
        (
            'a tape measure and a set square',
            planes,
            _Measured(offset=about.tape, tilt=about.square),
        ),
        (
            'a laser distance meter and a set square',
            planes,
            _Measured(offset=about.laser, tilt=about.square),
        ),
        ('a more accurate camera pose', posed, _Measured(pose=np.array(about.pose))),
    ):
        if possible:
            better = [None if c is None else _with(c, measured) for c in covariances]
            if _left(model.as_if(shift, better)) >= least:
                return words
    if _left(model.as_if(shift, exact=True)) >= least:
        return 'surfaces that are known more accurately'
    return 'a more accurate ground truth, such as a better scan'


@dataclass(frozen=True)
class _Measured:
    # Standard deviations of additional measurements; None if not measured.
    pose: np.ndarray | None = None
    offset: float | None = None
    tilt: float | None = None


def _with(covariance: np.ndarray, measured: _Measured) -> np.ndarray:
    # The covariance after these measurements.
    size = len(covariance)
    seen = np.full(size, np.inf)
    if measured.pose is not None:
        seen[:POSE] = measured.pose
    planes = seen[POSE:].reshape(-1, len(PLANE_STEPS))
    if measured.offset is not None:
        planes[:, 0] = measured.offset
    if measured.tilt is not None:
        planes[:, 1:] = measured.tilt
    some = np.flatnonzero(np.isfinite(seen))
    # The Kalman update.
    across = covariance[:, some]
    gain = across @ np.linalg.inv(covariance[np.ix_(some, some)] + np.diag(seen[some] ** 2))
    after = covariance - gain @ across.T
    return np.asarray((after + after.T) / 2)


def constants(candidate: Candidate) -> dict[str, str]:
    """Return the terms that do what another effect does, with its name."""
    return {
        term.name: term.stand_in.effect
        for one in candidate.kind.hypotheses
        for term in one.terms
        if term.stand_in and term.stand_in.decay is None
    }


def decidable_part(candidate: Candidate, hidden: Set[str]) -> Candidate:
    """
    Return a candidate without the terms that change depth just like one of the `hidden` effects.

    The constant of an amplitude bias is such a term where an offset is hidden: the fit would use
    it for whatever the ground truth leaves open. `candidate` is of none of them.
    """
    fixed = {name for name, effect in constants(candidate).items() if effect in hidden}
    free = [term.name not in fixed for term in candidate.terms]
    if all(free) or not any(free):
        return candidate

    def build(values: tuple[float, ...]) -> dict[str, float]:
        left = iter(values)
        return candidate.build(
            tuple(
                next(left) if one else term.neutral
                for term, one in zip(candidate.terms, free, strict=True)
            )
        )

    terms = tuple(term for term, one in zip(candidate.terms, free, strict=True) if one)
    given = candidate.given and decidable_part(candidate.given, hidden)
    return replace(candidate, terms=terms, build=build, given=given)


def parted(
    candidates: Sequence[Candidate], hidden: Set[str]
) -> tuple[list[Candidate], list[Candidate]]:
    """
    Return the candidates that can be decided, and those of `hidden` effects.

    No candidate has terms that do what an effect of the other list does; see `decidable_part`.
    """
    known = {one.effect for one in candidates} - hidden
    return (
        [decidable_part(one, hidden) for one in candidates if one.effect in known],
        [decidable_part(one, known) for one in candidates if one.effect in hidden],
    )


def decidable_candidates(
    model: Model, candidates: Sequence[Candidate], hidden: Sequence[Undecided]
) -> tuple[list[Candidate], list[Undecided]]:
    """
    Return the candidates that can explain a campaign, and what its ground truth hides.

    `hidden` is what the campaign's ground truth hides by the way it was made. The second list is
    ``absorbed`` for `decide`.
    """
    names = {one.effect for one in hidden if one.absorbed == 1}  # Fully hidden.
    left = [decidable_part(one, names) for one in candidates if one.effect not in names]
    if not model.own.posed.any():
        left = [one for one in left if one.kind.role != 'pose']
    # A pose error is not an effect of the camera, so the verdict does not depend on it.
    return left, [one for one in hidden if one.effect != of_role('pose').name]

"""Which effects explain the gap: forward selection, alternatives, the verdict."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.model import Fit, Model, SCALES
import numpy as np
from scipy import stats

# Calibrated on campaigns of the base simulator with pose, reflectivity and sigma errors, and on
# campaigns of the catalogue's and of made-up effects (bench/gap_development.py); a recording.
GAIN = 1.0
LEAST_GAIN = 0.5  # if the recordings agree, or there is a gap beyond doubt
_AGREE = 0.97
GAP = 5.5
_BEYOND_DOUBT = 2.0  # times that
MOST_EFFECTS = 6
_FILTERED = (0.8, 1.5)  # how much of a filter, and of noise, to begin with
NEXT_GAIN = 1.5
_TERM_COST = 0.5  # a recording
_WEAK_COST = 0.25  # a recording and factor of e below 0.4 of the usual strength
_FROM_NODE = (3.0, 1.0, 1.0)
_ALTERNATIVE = 0.8
_UNKNOWN_SHARE = 0.08
_NEXT_SHARE = 0.04  # half of it while less than half is explained
_PARTLY_SHARE = 0.5
# Poses that scatter by more than this share of what is usual are a finding of their own.
_SCATTERED = 0.48
_NEXT_TO_SCATTERED = 0.15  # for they leave edges behind
# Loss a recording that the base simulator with errors of pose and reflectivity leaves above that
# of noise alone: edges are known to a pixel only.
FLOOR = 4.0


@dataclass(frozen=True)
class Choice:
    """
    What one candidate set is worth.

    Attributes
    ----------
    fit : Fit
    gain : float
        Loss on held-out recordings that it takes off, less a cost for each of its parameters.

    """

    fit: Fit
    gain: float


@dataclass(frozen=True)
class Alternative:
    """
    An effect that does about as well in the place of a chosen one.

    Attributes
    ----------
    fit : Fit
        The effect is the last of its candidates.
    instead_of : tuple of str
        The chosen effects that it replaces.
    share : float
    interval : list of float
    confidence : float
        As for the chosen effects.

    """

    fit: Fit
    instead_of: tuple[str, ...]
    share: float
    interval: list[float]
    confidence: float


@dataclass(frozen=True)
class Decision:
    """
    The outcome.

    Attributes
    ----------
    verdict : str
        ``none``, ``identified``, ``partly`` or ``unknown``.
    base, chosen : Fit
        Without any effect; with those chosen (the best found, if the verdict is ``unknown``).
    shares, intervals, confidences : list
        An effect.
    alternatives : list of Alternative
        What could not be told apart from the effects chosen, best first; with ``unknown``, what
        came nearest.
    considered : list of Choice
        The best variant of each single effect, best first.
    excess : float
        Loss above that of noise alone.

    """

    verdict: str
    base: Fit
    chosen: Fit
    shares: list[float]
    intervals: list[list[float]]
    confidences: list[float]
    alternatives: list[Alternative]
    considered: list[Choice]
    excess: float


def decide(
    model: Model, candidates: Sequence[Candidate], tick: Callable[[], None] = lambda: None
) -> Decision:
    """
    Explain the gap.

    Parameters
    ----------
    model : Model
        The recordings.
    candidates : sequence of Candidate
        The catalogue.
    tick : callable
        Called now and then.

    """
    count = len(model.gap)
    base = model.fit([])
    null = float(model.null_loss.sum()) + FLOOR * count

    def choice(
        parts: Sequence[Candidate],
        start: np.ndarray | None = None,
        scales: Sequence[float] = SCALES,
    ) -> Choice:
        fit = model.fit(parts, start, scales)
        terms = len(fit.values) + 2 * any(c.kind.role == 'pose' for c in parts)
        return Choice(fit, base.total - fit.total - count * (_TERM_COST * terms + _oddity(fit)))

    def single(candidate: Candidate) -> Choice:
        # From nothing, and from a value that was simulated: there may be a hump between.
        tries = [choice([candidate])]
        if len(candidate.terms) == 1 and len(candidate.terms[0].nodes) > 1:
            value, _ = candidate.terms[0].nodes[len(candidate.terms[0].nodes) // 2]
            tries.append(choice([candidate], np.array([value]), _FROM_NODE))
        tick()
        return max(tries, key=lambda one: one.gain)

    singles = [single(candidate) for candidate in candidates]
    own = {one.fit.candidates[0]: one.fit.values for one in singles}
    considered = _best_of_each(singles)
    chosen = considered[0] if considered else Choice(base, 0.0)
    rivals, gained = considered[1:], 0.0
    next_share, posed = _NEXT_SHARE, [c for c in candidates if c.kind.role == 'pose']
    scattered = bool(posed) and model.pose_scatter() > _SCATTERED
    if scattered:
        chosen, next_share = choice(posed), _NEXT_TO_SCATTERED
        chosen = Choice(chosen.fit, max(chosen.gain, GAIN * count))
        rivals = []
    excess = max(base.inside - null - chosen.fit.pose_loss, 1e-9)
    if _counts(chosen, base, excess):
        for _ in range(MOST_EFFECTS - 1):
            taken = {c.effect for c in chosen.fit.candidates}
            more: list[Choice] = []
            for candidate in candidates:
                if candidate.effect not in taken:
                    together = [*chosen.fit.candidates, candidate]
                    more.append(
                        choice(together, np.concatenate([chosen.fit.values, own[candidate]]))
                    )
                    tick()
            if not more:
                break
            best = max(more, key=lambda c: c.gain)
            little = base.total - chosen.fit.total < 0.5 * excess
            least = max(NEXT_GAIN * count, next_share * excess * (0.5 if little else 1))
            if best.gain - chosen.gain < least:
                best = max(
                    _together(chosen, candidates, choice), key=lambda c: c.gain, default=best
                )
                if best.gain - chosen.gain < 2 * least:
                    break
                more = [best]
            gained = chosen.gain
            chosen = best
            rivals = [c for c in _best_of_each(more, last=True) if c is not best]
        whole = chosen
        if not scattered:
            chosen = _prune(chosen, choice, NEXT_GAIN * count)
        if chosen is not whole:
            alone = len(chosen.fit.candidates) == 1
            rivals, gained = (
                (
                    [
                        c
                        for c in considered
                        if c.fit.candidates[0].effect != chosen.fit.candidates[0].effect
                    ]
                    if alone
                    else []
                ),
                0.0,
            )
        excess = max(base.inside - null - chosen.fit.pose_loss, 1e-9)
    equals = [
        c
        for c in rivals
        if c.gain - gained >= _ALTERNATIVE * (chosen.gain - gained) > 0
        and _certainty(chosen.fit, c.fit) < 0.95
    ][:5]
    found = chosen
    if any(c.given for c in chosen.fit.candidates):
        chosen = choice([c.given or c for c in chosen.fit.candidates], chosen.fit.values)
    parts = chosen.fit.candidates
    if len(parts) > 1:
        without = [choice([c for c in parts if c is not part]) for part in parts]
    else:
        without = [Choice(base, 0.0)] * len(parts)
    losses = [other.fit for other in without]
    shares = [min(max((one.total - chosen.fit.total) / excess, 0.0), 1.0) for one in losses]
    intervals = [interval(model, one, chosen.fit, base) for one in losses]
    confidences = [
        min((_certainty(chosen.fit, c.fit) for c in [*rivals[:5], other]), default=1.0)
        for other in without
    ]
    verdict = _verdict(found, base, excess, found.fit.loss.sum() - null)
    unknown = verdict == 'unknown'
    alternatives = [
        _alternative(model, choice, base, excess, one, base if unknown else chosen.fit)
        for one in (considered[:3] if unknown else equals)
    ]
    return Decision(
        verdict, base, chosen.fit, shares, intervals, confidences, alternatives, considered, excess
    )


def _alternative(
    model: Model, choice: Callable[..., Choice], base: Fit, excess: float, one: Choice, chosen: Fit
) -> Alternative:
    rest = one.fit.candidates[:-1]
    without = choice(rest).fit if rest else base
    kept = {c.effect for c in one.fit.candidates}
    return Alternative(
        one.fit,
        tuple(c.effect for c in chosen.candidates if c.effect not in kept),
        float(np.clip((without.total - one.fit.total) / excess, 0, 1)),
        interval(model, without, one.fit, base),
        _certainty(one.fit, chosen),
    )


def _together(
    chosen: Choice, candidates: Sequence[Candidate], choice: Callable[..., Choice]
) -> list[Choice]:
    # A camera's noise is measured behind its filters: with a filter alone there is too little.
    taken = {c.effect for c in chosen.fit.candidates}
    noise = [c for c in candidates if c.kind.role == 'sigma']
    if any(one.effect in taken for one in noise):
        return []
    return [
        choice(
            [*chosen.fit.candidates, one, *noise], np.concatenate([chosen.fit.values, _FILTERED])
        )
        for one in candidates
        if noise and one.kind.filters and one.effect not in taken
    ]


def _oddity(fit: Fit) -> float:
    # An effect much weaker than usual is less likely than another one of usual strength.
    cost, i = 0.0, 0
    for candidate in fit.candidates:
        cost += candidate.kind.doubt
        if len(candidate.terms) == 1:
            term = candidate.terms[0]
            usual = abs(term.nodes[len(term.nodes) // 2][0] - term.neutral)
            size = max(abs(float(fit.values[i]) - term.neutral), 1e-3 * usual)
            cost += _WEAK_COST * max(np.log(usual / size) - np.log(2.5), 0.0)
        i += len(candidate.terms)
    return cost


def _counts(chosen: Choice, base: Fit, excess: float) -> bool:
    count = len(base.loss)
    return chosen.gain >= GAIN * count or (
        chosen.gain >= LEAST_GAIN * count
        and (excess >= _BEYOND_DOUBT * GAP * count or _certainty(chosen.fit, base) >= _AGREE)
    )


def _verdict(chosen: Choice, base: Fit, excess: float, left: float) -> str:
    count = len(base.loss)
    if not _counts(chosen, base, excess):
        return 'none' if excess < GAP * count else 'unknown'
    much = left > GAP * count
    # A pose error common to all recordings hides in their own: it takes little off the features.
    posed = any(c.kind.role == 'pose' for c in chosen.fit.candidates)
    if much and base.total - chosen.fit.total < _UNKNOWN_SHARE * excess and not posed:
        return 'unknown'
    return 'partly' if much and left > _PARTLY_SHARE * excess else 'identified'


def _best_of_each(choices: Sequence[Choice], last: bool = False) -> list[Choice]:
    best: dict[str, Choice] = {}
    for one in sorted(choices, key=lambda c: -c.gain):
        names = [c.effect for c in one.fit.candidates]
        best.setdefault(names[-1 if last else 0], one)
    return list(best.values())


def _prune(chosen: Choice, choice: Callable[..., Choice], least: float) -> Choice:
    # What was picked first may have stood in for what came later.
    while len(chosen.fit.candidates) > 1:
        parts = chosen.fit.candidates
        rest = [choice([c for c in parts if c is not part]) for part in parts]
        best = max(rest, key=lambda c: c.gain)
        if chosen.gain - best.gain >= least:
            break
        chosen = best
    return chosen


def _certainty(one: Fit, other: Fit) -> float:
    # That one explains recordings it has not seen better than the other.
    count = len(one.held_out)
    difference = other.held_out - one.held_out + (other.pose_held_out - one.pose_held_out) / count
    if count < 2:
        return 0.5
    error = float(difference.std(ddof=1)) / np.sqrt(count) + 0.25
    t = float(difference.mean()) / error
    return float(stats.t.cdf(t, count - 1))


def interval(model: Model, without: Fit, chosen: Fit, base: Fit) -> list[float]:
    """
    Return the 90 % interval of the share of the gap that an effect explains.

    The jackknife over recordings, with Student's t.
    """
    count = len(base.loss)
    pose = (without.pose_held_out - chosen.pose_held_out) / count
    top = without.held_out - chosen.held_out + pose
    bottom = (
        base.loss
        - model.null_loss.sum(axis=1)
        - FLOOR
        + (base.pose_loss - chosen.pose_loss) / count
    )
    return ratio_interval(top, bottom)


def ratio_interval(top: np.ndarray, bottom: np.ndarray) -> list[float]:
    """
    Return the 90 % interval of sum(top) / sum(bottom) in as many other recordings, within 0..1.

    The jackknife says how much the ratio varies from one set of recordings to another; what is
    predicted and what is found in the other set both do.
    """
    count = len(top)
    whole = top.sum() / max(bottom.sum(), 1e-9)
    if count < 3:
        return [0.0, 1.0]
    rest = (top.sum() - top) / np.maximum(bottom.sum() - bottom, 1e-9)
    error = np.sqrt((count - 1) / count * np.square(rest - rest.mean()).sum())
    reach = float(stats.t.ppf(0.95, count - 1)) * math.sqrt(2) * float(error)
    return [float(np.clip(whole - reach, 0, 1)), float(np.clip(whole + reach, 0, 1))]

"""The joint model of all recordings: effects that they share, a pose error of each one's own."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import loadable
from flexx2_sim_ros.gap.data.covariates import AXES
from flexx2_sim_ros.gap.data.pose import STEPS
from flexx2_sim_ros.gap.features.catalogue import Candidate, Column, Decaying, nuisances, Term
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import LAYOUT, SIZE, STRUCTURES, TOLERANCE
from flexx2_sim_ros.gap.features.grain import repeats, same_noise
import numpy as np

_BRIGHTNESS_WEIGHT = 1.5
# The base sigma is wrong by some 5 %; what that costs at twice as much is four times this, so that
# one wrong by less than 15 % is no finding.
_SIGMA_SPREAD, _SIGMA_WEIGHT, SIGMA_BOUND = 0.05, 0.8, 0.16
_POSE_WEIGHT = 0.5
_POSE_FLOOR = np.array([0.25, 0.25, 0.25, 0.3, 0.3, 0.15])  # steps
SCALES = (20.0, 6.0, 2.0, 1.0, 1.0, 1.0)
# Edges are known to a pixel only: those on each side may lie elsewhere by this much, pixels.
_EDGE_SHIFT = 0.4
_EDGE_WEIGHT = 0.5
# Edges are known the worse the further the camera is from where it was believed to be: factor on
# the variance for poses as wrong as usual.
_EDGES_MOVED = 6.0
_OWN = 11  # a recording's own errors: pose (6), brightness, edges (4)
_STRUCTURE = {name: SIZE - len(STRUCTURES) + i for i, name in enumerate(STRUCTURES)}
# Share by which the number of pixels that are lost or grossly wrong may differ from what the
# catalogue's model of an effect says: where that begins is no more than a form that fits, and next
# to the tolerances large effects would never be explained.
_MISMATCH2 = np.array(
    [0.25**2 if f.channel in ('invalid', 'high', 'low') else 0.0 for f in LAYOUT], np.float32
)
# What edges show hangs together, for all of it shifts with where they are taken to be.
_EDGE_SHARE = 1.0
_WEIGHTS = np.array(
    [
        3.0
        if f.axis == 'structure'
        else (_EDGE_SHARE if f.axis == 'edge' else 1.0) / np.sqrt(AXES[f.axis].bins)
        for f in LAYOUT
    ]
)


@dataclass
class Fit:
    """
    A set of candidates, fitted.

    Attributes
    ----------
    candidates : tuple of Candidate
    values : numpy.ndarray
        Of all their terms.
    left_out : numpy.ndarray
        (R, n) values fitted without each recording.
    sigma : float
        How much sigma is wrong, relative.
    motion : numpy.ndarray
        (R, 11) each recording's pose beyond the first fit, in steps, brightness and edges.
    loss, held_out : numpy.ndarray
        (R,) loss of each recording's features, with all recordings' values and with left_out's.
    pose_loss, pose_held_out : float

    """

    candidates: tuple[Candidate, ...]
    values: np.ndarray
    left_out: np.ndarray
    sigma: float
    motion: np.ndarray
    loss: np.ndarray
    held_out: np.ndarray
    pose_loss: float
    pose_held_out: float

    @property
    def total(self) -> float:
        """Loss on held-out recordings."""
        return float(self.held_out.sum()) + self.pose_held_out

    @property
    def inside(self) -> float:
        """Loss on the recordings it was fitted on."""
        return float(self.loss.sum()) + self.pose_loss


class Model:
    """
    The gap of all recordings.

    Parameters
    ----------
    evidence : sequence of Evidence
    columns : sequence of Column
        Of the evidence.
    prior : numpy.ndarray
        (6,) standard deviations of pose errors, metres and degrees.

    Attributes
    ----------
    same_noise : list of int or None
        For each recording another one that has the very same noise.
    pose_centre : numpy.ndarray or None
        (6,) metres and degrees about which the poses are taken to lie, if that is known.

    """

    def __init__(
        self, evidence: Sequence[Evidence], columns: Sequence[Column], prior: np.ndarray
    ) -> None:
        """Stack the summaries."""
        self.evidence = list(evidence)
        self.pose_centre: np.ndarray | None = None
        self._nodes: dict[tuple[Any, ...], tuple[np.ndarray, np.ndarray]] = {}
        self.index = {column.name: i for i, column in enumerate(columns)}
        real = np.array([e.real for e in evidence])
        base = np.array([e.base for e in evidence])
        repeat = _STRUCTURE['repeat']
        real[:, repeat] = repeats([e.grain for e in evidence])
        self.same_noise = same_noise([e.fingerprint for e in evidence])
        # Noise that is the same looks like a pattern that is.
        real[[one is not None for one in self.same_noise], repeat] = np.nan
        base[:, repeat] = repeats([e.null_grain for e in evidence])
        noise = np.array([e.noise + e.base_variance for e in evidence])
        self.scale2 = np.square(TOLERANCE) + 2 * np.nan_to_num(noise, posinf=0.0)
        gap = real - base
        self.good = np.isfinite(gap)
        self.gap = np.where(self.good, gap, 0.0)
        self.weights = np.where(self.good, _WEIGHTS, 0.0)
        self.pose_columns = np.array([e.pose_columns for e in evidence])
        self.pose = np.array([e.pose for e in evidence]) / STEPS
        self.prior = prior / STEPS
        # Pixels beside jumps to the right and left shift with yaw, below and above with pitch.
        self._edges = (
            np.stack(
                [
                    np.array([e.edge_columns[1 if side < 2 else 0] for e in evidence])
                    * np.array([f.axis == 'edge' and f.place // 4 == side for f in LAYOUT])
                    for side in range(4)
                ],
                axis=1,
            )
            * _EDGE_SHIFT
        )
        far = 1 + _EDGES_MOVED * np.square(self.pose / self.prior).mean(axis=1)
        self.scale2 += far[:, None] * np.array([e.displaced for e in evidence])
        self._columns = np.array([e.columns for e in evidence])
        self._repeat_shift(columns, base)
        for name in ('scale2', 'gap', 'weights', 'pose_columns', '_edges'):
            setattr(self, name, getattr(self, name).astype(np.float32))
        wrong = nuisances()
        self._more = self._column(wrong.more) / np.float32(wrong.more_by)
        self._less = self._column(wrong.less) / np.float32(wrong.less_by)
        self.null_loss = self._null_loss()

    def _repeat_shift(self, columns: Sequence[Column], base: np.ndarray) -> None:
        # How alike a fixed pattern makes the grain of different recordings.
        grain, repeat = _STRUCTURE['static_grain'], _STRUCTURE['repeat']
        others, known = max(len(base) - 1, 1), loadable()
        for i, column in enumerate(columns):
            if any(known[effect].repeats for effect in column.effects):
                signal = np.maximum(self._columns[:, i, grain], 0)
                rest = np.maximum(np.nan_to_num(base[:, grain]), 1e-6)
                self._columns[:, i, repeat] = signal / np.sqrt(
                    (signal + rest) * (signal + rest / others)
                )

    def _null_loss(self) -> np.ndarray:
        # (R, SIZE) loss of recordings that are nothing but the base simulator's.
        out = np.zeros_like(self.gap)
        for r, one in enumerate(self.evidence):
            for k, null in enumerate(one.nulls):
                gap = null - np.delete(one.nulls, k, axis=0).mean(axis=0)
                out[r] += np.log1p(np.nan_to_num(gap) ** 2 / self.scale2[r]) / len(one.nulls)
        return out * self.weights

    def _column(self, name: str | Decaying) -> np.ndarray:
        if isinstance(name, str):
            return self._columns[:, self.index[name]]
        left = [
            0.0 if one.uptime is None else float(np.exp(-one.uptime / name.tau))
            for one in self.evidence
        ]
        share = (name.factor * np.array(left)[:, None]).astype(np.float32)
        return self._columns[:, self.index[name.column]] * share

    def term(self, term: Term, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the shift of all features at (R,) values of a term, and its slope; (R, SIZE)."""
        key = term.nodes
        cache = self._nodes
        if key not in cache:
            points = sorted(
                [
                    (term.neutral, np.zeros_like(self.gap)),
                    *((v, self._column(c)) for v, c in term.nodes),
                ],
                key=lambda x: x[0],
            )
            cache[key] = (np.array([v for v, _ in points]), np.array([c for _, c in points]))
        places, shifts = cache[key]
        low = np.clip(np.searchsorted(places, values) - 1, 0, len(places) - 2)
        rows = np.arange(len(values))
        start, end = shifts[low, rows], shifts[low + 1, rows]
        slope = (end - start) / (places[low + 1] - places[low])[:, None].astype(np.float32)
        return start + slope * (values - places[low])[:, None].astype(np.float32), slope

    def predict(
        self, candidates: Sequence[Candidate], values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return shifts (R, SIZE) and their slopes (R, n, SIZE) at (R, n) values."""
        total, slopes = np.zeros_like(self.gap), []
        terms = [term for candidate in candidates for term in candidate.terms]
        for i, term in enumerate(terms):
            shift, slope = self.term(term, values[:, i])
            total += shift
            slopes.append(slope)
        return total, (np.stack(slopes, axis=1) if slopes else np.zeros((len(self.gap), 0, SIZE)))

    def residual(self, fit: Fit) -> np.ndarray:
        """Return what a fit leaves of the gap, (R, SIZE)."""
        columns, shift = self._nuisances(fit.candidates, np.tile(fit.values, (len(self.gap), 1)))
        return self.gap - shift - self._wrong(fit.sigma) - _combine(fit.motion, columns)

    def shift(self, fit: Fit) -> np.ndarray:
        """Return what a fit's effects change, (R, SIZE)."""
        return self.predict(fit.candidates, np.tile(fit.values, (len(self.gap), 1)))[0]

    def losses(self, residual: np.ndarray, shift: np.ndarray | None = None) -> np.ndarray:
        """Return each recording's loss, (R,), of what is left when effects change ``shift``."""
        if shift is None:
            loss = np.log1p(residual**2 / self.scale2)
        else:  # Cauchy's, of a scale that grows with what is predicted.
            wide2 = self._wide2(shift)
            loss = np.log1p(residual**2 / wide2) + np.float32(0.5) * np.log(wide2 / self.scale2)
        return (self.weights * loss).sum(axis=1, dtype=float)

    def _wide2(self, shift: np.ndarray) -> np.ndarray:
        return self.scale2 + _MISMATCH2 * shift**2

    def pose_loss(self, motion: np.ndarray, common: bool, held_out: bool = False) -> float:
        """Return what the recordings' own errors cost: the logarithm of the poses' spread."""
        q = self.pose + motion[:, :6]
        if self.pose_centre is not None:
            q = q - self.pose_centre / STEPS
        elif common:
            q = (q - q.mean(axis=0)) * (len(q) / max(len(q) - 1, 1) if held_out else 1.0)
        spread = (q**2).mean(axis=0)
        return float(
            _POSE_WEIGHT * len(q) * np.log1p(spread / _POSE_FLOOR**2).sum()
            + _BRIGHTNESS_WEIGHT * np.square(motion[:, 6]).sum()
            + _EDGE_WEIGHT * np.square(motion[:, 7:]).sum()
        )

    def pose_scatter(self) -> float:
        """Return how far the recordings' poses scatter, as a share of what is usual."""
        still = np.array([not e.moving for e in self.evidence])
        pose = np.array([e.sure_pose for e in self.evidence]) / STEPS / self.prior
        return float((pose[still] if still.sum() > 2 else pose).std(axis=0).mean())

    def _nuisances(
        self, candidates: Sequence[Candidate], values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        # (R, _OWN, SIZE) what each recording's own errors change: its pose, its brightness, which
        # scales what depends on amplitude, its edges; with the total shift, (R, SIZE).
        total, bright, i = np.zeros_like(self.gap), np.zeros_like(self.gap), 0
        for candidate in candidates:
            n = len(candidate.terms)
            shift, _ = self.predict([candidate], values[:, i : i + n])
            total += shift
            bright += np.float32(candidate.kind.brightness) * shift
            i += n
        return np.concatenate([self.pose_columns, bright[:, None], self._edges], axis=1), total

    def _hold(self, motion: np.ndarray, common: bool) -> tuple[np.ndarray, np.ndarray]:
        # How stiffly the recordings' own errors are held, (_OWN,), and how far they are off.
        q = self.pose + motion[:, :6]
        centre = (
            self.pose_centre / STEPS
            if self.pose_centre is not None
            else q.mean(axis=0)
            if common
            else 0.0
        )
        off = q - centre
        stiff = _POSE_WEIGHT / (_POSE_FLOOR**2 + (off**2).mean(axis=0))
        return (
            np.concatenate([stiff, [_BRIGHTNESS_WEIGHT], [_EDGE_WEIGHT] * 4]),
            np.concatenate([off, motion[:, 6:]], axis=1),
        )

    def fit(
        self,
        candidates: Sequence[Candidate],
        start: np.ndarray | None = None,
        scales: Sequence[float] = SCALES,
    ) -> Fit:
        """
        Fit a set of candidates robustly, and again without each recording.

        Parameters
        ----------
        candidates : sequence of Candidate
            The set.
        start : numpy.ndarray, optional
            Values to start from; zeros when left out.
        scales : sequence of float
            How far away a feature must be to count as an outlier, in units of its tolerance, from
            step to step.

        """
        terms = [term for candidate in candidates for term in candidate.terms]
        low, high = np.array([t.low for t in terms]), np.array([t.high for t in terms])
        common = any(c.kind.role == 'pose' for c in candidates)
        # Excess noise is a base sigma that is wrong: not both.
        bound = 0.0 if any(c.kind.role == 'sigma' for c in candidates) else SIGMA_BOUND
        number, count = len(terms), len(self.gap)
        values = np.array([t.neutral for t in terms]) if start is None else np.array(start, float)
        sigma, motion = 0.0, np.zeros((count, _OWN))
        left_out = np.tile(values, (count, 1))
        for scale in scales:
            tiled = np.tile(values, (count, 1))
            _, slopes = self.predict(candidates, tiled)
            own_columns, shift = self._nuisances(candidates, tiled)
            residual = self.gap - shift - self._wrong(sigma) - _combine(motion, own_columns)
            base_noise = self._more if sigma >= 0 else self._less
            design = np.concatenate([slopes, base_noise[:, None], own_columns], axis=1)
            weight = self.weights / (self._wide2(shift) * np.float32(scale**2) + residual**2)
            weighted = design * weight[:, None]
            normal = (weighted @ design.transpose(0, 2, 1)).astype(float)
            right = (weighted @ residual[..., None])[..., 0].astype(float)
            n = number + 1
            stiff, off = self._hold(motion, common)
            index = np.arange(_OWN)
            normal[:, n + index, n + index] += stiff
            right[:, n:] -= stiff * off
            inverse = np.linalg.inv(normal[:, n:, n:])
            across = normal[:, :n, n:] @ inverse
            own = normal[:, :n, :n] - across @ normal[:, n:, :n]
            target = right[:, :n] - (across @ right[:, n:, None])[..., 0]
            # Shared out, so that the fits without a recording have it too.
            own[:, number, number] += _SIGMA_WEIGHT / _SIGMA_SPREAD**2 / count
            target[:, number] -= _SIGMA_WEIGHT / _SIGMA_SPREAD**2 / count * sigma
            step = _solve(own.sum(axis=0), target.sum(axis=0))
            new = np.clip(values + step[:number], low, high)
            new_sigma = float(np.clip(sigma + step[number], -bound, bound))
            if abs(new_sigma) == bound and number:
                # Held at its bound; the rest again, given that.
                total, aim = own.sum(axis=0), target.sum(axis=0)
                aim = aim[:number] - total[:number, number] * (new_sigma - sigma)
                new = np.clip(values + _solve(total[:number, :number], aim), low, high)
            move = np.concatenate([new - values, [new_sigma - sigma]])
            motion = (
                motion + (inverse @ (right[:, n:] - normal[:, n:, :n] @ move)[..., None])[..., 0]
            )
            for r in range(count):
                total, aim = own.sum(axis=0) - own[r], target.sum(axis=0) - target[r]
                aim = aim[:number] - total[:number, number] * (new_sigma - sigma)
                left_out[r] = np.clip(values + _solve(total[:number, :number], aim), low, high)
            values, sigma = new, new_sigma
        loss, motion = self._settle(candidates, np.tile(values, (count, 1)), sigma, motion, common)
        held_out, other = self._settle(candidates, left_out, sigma, motion, common)
        wrong = _SIGMA_WEIGHT * (sigma / _SIGMA_SPREAD) ** 2
        return Fit(
            tuple(candidates),
            values,
            left_out,
            sigma,
            motion,
            loss,
            held_out,
            self.pose_loss(motion, common) + wrong,
            self.pose_loss(other, common, held_out=True) + wrong,
        )

    def _wrong(self, sigma: float) -> np.ndarray:
        # (R, SIZE) what a base sigma that is wrong by a share changes.
        return np.float32(sigma) * (self._more if sigma >= 0 else self._less)

    def _settle(
        self,
        candidates: Sequence[Candidate],
        values: np.ndarray,
        sigma: float,
        motion: np.ndarray,
        common: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        own_columns, shift = self._nuisances(candidates, values)
        return self.settle(
            self.gap - shift - self._wrong(sigma), motion, common, own_columns, shift
        )

    def settle(
        self,
        gap: np.ndarray,
        motion: np.ndarray,
        common: bool,
        columns: np.ndarray,
        shift: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return each recording's loss and own errors.

        ``gap`` is what is left of it otherwise, ``shift`` what effects change.
        """
        wide2 = self._wide2(shift)
        for _ in range(2):
            residual = gap - _combine(motion, columns)
            weighted = columns * (self.weights / (wide2 + residual**2))[:, None]
            stiff, off = self._hold(motion, common)
            normal = (weighted @ columns.transpose(0, 2, 1)).astype(float) + np.diag(stiff)
            right = (weighted @ residual[..., None])[..., 0] - stiff * off
            motion = motion + np.linalg.solve(normal, right[..., None])[..., 0]
        return self.losses(gap - _combine(motion, columns), shift), motion


def _combine(amounts: np.ndarray, columns: np.ndarray) -> np.ndarray:
    # (R, n) and (R, n, SIZE) to (R, SIZE).
    return (amounts[:, None].astype(np.float32) @ columns)[:, 0]


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    if not len(right):
        return right
    size = np.maximum(np.sqrt(np.diag(matrix)), 1e-12)
    scaled = matrix / np.outer(size, size) + 1e-6 * np.eye(len(right))
    return np.linalg.solve(scaled, right / size) / size

"""The joint model of all recordings: shared effects, and nuisance parameters of each recording."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

from flexx2_sim_ros.effects import loadable
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.calibration.features import SIMULATION
from flexx2_sim_ros.gap.calibration.inference import LOSS
from flexx2_sim_ros.gap.data.axes import AXES
from flexx2_sim_ros.gap.data.pose import STEPS
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.gap.features.catalogue import (
    Candidate,
    CandidateTerm,
    Column,
    Decaying,
    nuisances,
)
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import Feature, LAYOUT, SIZE, STRUCTURE_UNITS, TOLERANCE
from flexx2_sim_ros.gap.features.grain import repeats, same_noise
from flexx2_sim_ros.gap.inference.own_errors import COMMON, OwnErrors
import numpy as np

_STRUCTURE = {name: SIZE - len(STRUCTURE_UNITS) + i for i, name in enumerate(STRUCTURE_UNITS)}
_COUNTED = np.array([f.channel in ('invalid', 'high', 'low') for f in LAYOUT])
_STRUCTURED = np.array([f.axis == 'structure' for f in LAYOUT])
_BINS = np.array([1 if f.axis == 'structure' else AXES[f.axis].bins for f in LAYOUT])


class Model:
    """
    The gap of all recordings.

    Parameters
    ----------
    prior : numpy.ndarray
        (6,) standard deviations of pose errors, metres and degrees.
    held : bool
        Whether the prior holds poses whose recordings say nothing of them. Otherwise they may
        scatter as much as they do.

    Attributes
    ----------
    same_noise : list of int or None
        For each recording another recording with identical noise, if there is one.
    own : OwnErrors
        The recordings' nuisances and their prior.

    """

    def __init__(
        self,
        evidence: Sequence[Evidence],
        columns: Sequence[Column],
        prior: np.ndarray,
        held: bool = False,
    ) -> None:
        """Stack the summaries."""
        self.constants, self.held = LOSS, held
        self.evidence = list(evidence)
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
        # That of a recording, and of the mean of simulations.
        noise = np.array([e.noise + e.noise / SIMULATION.null_seeds for e in evidence])
        self.scale2 = np.square(TOLERANCE) + LOSS.noise_factor * np.nan_to_num(noise, posinf=0.0)
        gap = real - base
        self.good = np.isfinite(gap)
        self.gap = np.where(self.good, gap, 0.0)
        self.weights = np.where(
            self.good, np.where(_STRUCTURED, LOSS.structure_weight, 1 / np.sqrt(_BINS)), 0.0
        )
        self._mismatch2 = np.where(_COUNTED, LOSS.mismatch**2, 0.0).astype(np.float32)
        stated = np.diag(np.square(prior)) if held else None
        known = [stated if e.covariance is None else e.covariance for e in evidence]
        self.own = OwnErrors(evidence, known, LOSS)
        self._pose_columns = np.array([e.pose_columns for e in evidence])
        self._plane_columns = np.zeros((len(gap), self.own.count - COMMON, SIZE))
        for columns_of, e in zip(self._plane_columns, evidence, strict=True):
            columns_of[: len(e.plane_columns)] = e.plane_columns
        self.prior, self._prior = prior, prior / STEPS
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
            * LOSS.edge_shift
        )
        far = 1 + LOSS.edges_moved * np.square(self.own.pose / self._prior).mean(axis=1)
        self.scale2 += far[:, None] * np.array([e.displaced for e in evidence])
        self._truth2 = np.square(GROUND_TRUTH.reach * np.array([e.truth_spread for e in evidence]))
        self.scale2 += self._truth2
        self._columns = np.array([e.columns for e in evidence])
        self._repeat_shift(columns, base)
        for name in ('scale2', 'gap', 'weights', '_pose_columns', '_plane_columns', '_edges'):
            setattr(self, name, getattr(self, name).astype(np.float32))
        wrong = nuisances()
        self.carried = self._carried_bright = np.float32(0) * self.gap
        self._more = self.column(wrong.more) / np.float32(wrong.more_by)
        self._less = self.column(wrong.less) / np.float32(wrong.less_by)
        self.null_loss = self._null_loss()

    @property
    def seen(self) -> np.ndarray:
        """Return (R,) bool, whether a recording has enough surfaces to say anything."""
        return np.asarray(self.good[:, LAYOUT.index(Feature('bias', 'all', 0))])

    def _repeat_shift(self, columns: Sequence[Column], base: np.ndarray) -> None:
        # How alike a fixed pattern makes the grain of different recordings.
        grain, repeat = _STRUCTURE['static_grain'], _STRUCTURE['repeat']
        others, known = max(len(base) - 1, 1), loadable()
        for i, column in enumerate(columns):
            if any(known[effect].repeats for effect in column.changed):
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

    def column(self, name: str | Decaying) -> np.ndarray:
        """
        Return by how much a simulation with an effect differs from those without, (R, SIZE).

        The columns of `Evidence` lack how much recordings have a fixed pattern in common.
        """
        if isinstance(name, str):
            return self._columns[:, self.index[name]]
        left = [
            0.0 if one.uptime is None else float(np.exp(-one.uptime / name.tau))
            for one in self.evidence
        ]
        remaining = (name.factor * np.array(left)[:, None]).astype(np.float32)
        return self._columns[:, self.index[name.column]] * remaining

    def term(self, term: CandidateTerm, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the shift of all features at (R,) values of a term, and its slope; (R, SIZE)."""
        key = term.nodes
        cache = self._nodes
        if key not in cache:
            points = sorted(
                [
                    (term.neutral, np.zeros_like(self.gap)),
                    *((v, self.column(c)) for v, c in term.nodes),
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

    def losses(self, residual: np.ndarray, shift: np.ndarray | None = None) -> np.ndarray:
        """
        Return each recording's loss, (R,): Cauchy's, summed over features.

        `residual` is (R, SIZE) what is left of the gap, `shift` (R, SIZE) what effects change: the
        scale of the loss grows with it.
        """
        if shift is None:
            loss = np.log1p(residual**2 / self.scale2)
        else:
            wide2 = self.wide2(shift)
            loss = np.log1p(residual**2 / wide2) + np.float32(0.5) * np.log(wide2 / self.scale2)
        return (self.weights * loss).sum(axis=1, dtype=float)

    def wide2(self, shift: np.ndarray) -> np.ndarray:
        """Return the squared scale of the loss, (R, SIZE), where effects change ``shift``."""
        return self.scale2 + self._mismatch2 * (shift + self.carried) ** 2

    def sigma_column(self, sigma: float) -> np.ndarray:
        """Return the features' slope, (R, SIZE), with the base sigma's relative error."""
        return self._more if sigma >= 0 else self._less

    def sigma_shift(self, sigma: float) -> np.ndarray:
        """Return what a base sigma with this relative error changes, (R, SIZE)."""
        return np.float32(sigma) * self.sigma_column(sigma)

    def nuisance_columns(
        self, candidates: Sequence[Candidate], values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return what each recording's nuisances change, (R, N, SIZE), and the candidates, (R, SIZE).

        Nuisances are its pose error, its brightness, which scales what depends on amplitude, its
        edges, and its planes, where they are known within bounds only. `values` is (R, n), of the
        candidates' terms.
        """
        total, bright, i = np.zeros_like(self.gap), self._carried_bright.copy(), 0
        for candidate in candidates:
            n = len(candidate.terms)
            shift, _ = self.predict([candidate], values[:, i : i + n])
            total += shift
            bright += np.float32(candidate.kind.brightness) * shift
            i += n
        own = [self._pose_columns, bright[:, None], self._edges, self._plane_columns]
        return np.concatenate(own, axis=1), total

    def pose_scatter(self) -> float:
        """Return the spread of the recordings' poses, as a fraction of the usual spread."""
        usual = np.array([self._usual_pose(e) for e in self.evidence])
        pose = np.array([e.sure_pose for e in self.evidence]) / STEPS / usual
        return float(pose.std(axis=0).mean())

    def _usual_pose(self, one: Evidence) -> np.ndarray:
        # (6,) standard deviations of a recording's pose, in steps.
        if one.covariance is None:
            return self._prior
        own = np.sqrt(np.diag(one.covariance)[:POSE]) / STEPS
        return np.asarray(np.hypot(own, self.constants.pose_floor))

    def carrying(self, without: Mapping[str, str]) -> 'Model':
        """
        Return the model of recordings beside a base simulator that has effects.

        `without` names for each effect the column of the base simulator without it.
        """
        other = copy(self)
        for name, column in without.items():
            shift = -self.column(column)
            other.carried = other.carried + shift
            bright = np.float32(loadable()[name].brightness) * shift
            other._carried_bright = other._carried_bright + bright
        return other

    def widened(self, factor: float) -> 'Model':
        """Return the model with the scale of the loss times a factor."""
        other = copy(self)
        other.scale2 = self.scale2 * np.float32(factor**2)
        # The noise is measured as well as before.
        about = self.constants
        other.constants = replace(about, sigma_weight=about.sigma_weight / factor**2)
        other.null_loss = other._null_loss()
        return other

    def only(self, candidate: Candidate, has: np.ndarray) -> 'Model':
        """Return the model in which a candidate changes only the recordings that (R,) has it."""
        other = copy(self)
        other._columns, other._nodes = self._columns.copy(), {}
        index = np.array([self.index[name] for name in candidate.columns])
        other._columns[np.ix_(~has, index)] = 0
        return other

    def with_gap(self, gap: np.ndarray) -> 'Model':
        """Return the model of the same recordings with another gap, (R, SIZE)."""
        other = copy(self)
        other.gap = np.where(self.good, gap, 0).astype(np.float32)
        return other

    def as_if(
        self,
        gap: np.ndarray,
        covariances: Sequence[np.ndarray | None] | None = None,
        exact: bool = False,
    ) -> 'Model':
        """
        Return the model of recordings with another gap, (R, SIZE), that were not registered.

        `covariances` is what is known of the recordings' own errors, as it is when left out.
        `exact`: the depth of the ground truth is known without error.
        """
        other = self.with_gap(gap)
        known = [e.covariance for e in self.evidence] if covariances is None else covariances
        other.own = OwnErrors(self.evidence, known, self.constants, registered=False)
        if exact:
            other.scale2 = self.scale2 - self._truth2.astype(np.float32)
        return other


def combine(amounts: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the sum of (R, N, SIZE) columns, each times its amount of (R, N); (R, SIZE)."""
    return np.asarray((amounts[:, None].astype(np.float32) @ columns)[:, 0])

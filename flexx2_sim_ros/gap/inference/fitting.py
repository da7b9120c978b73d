"""
Fit effects that all recordings share, with a pose error of each recording's own.

An M-estimator with Cauchy's loss, by iteratively reweighted least squares; the recordings'
nuisances are eliminated in each step, and the last step is repeated without each recording
(leave-one-out cross-validation). See `normal_equations` for the sources.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.features.catalogue import Candidate
from flexx2_sim_ros.gap.inference.model import combine, Model
from flexx2_sim_ros.gap.inference.normal_equations import (
    cauchy_weights,
    leave_one_out_steps,
    normal_equations,
    solve,
    solve_given_last,
)
from flexx2_sim_ros.physics.poses import eliminate_nuisances, SharedEquations
import numpy as np


@dataclass
class Fit:
    """
    A set of candidates, fitted.

    * `values`: (n,) of all their terms.
    * `left_out`: (R, n) values fitted without each recording.
    * `sigma`: relative error of the base sigma_z.
    * `nuisances`: (R, N) each recording's pose beyond its registration, in steps; brightness;
      edges; planes beyond their registration, in steps.
    * `loss`, `held_out`: (R,) loss of each recording's features, with ``values`` and with
      ``left_out``.
    * `pose_loss`, `pose_held_out`: loss of the nuisances and sigma, likewise.
    """

    candidates: tuple[Candidate, ...]
    values: np.ndarray
    left_out: np.ndarray
    sigma: float
    nuisances: np.ndarray
    loss: np.ndarray
    held_out: np.ndarray
    pose_loss: float
    pose_held_out: float

    @property
    def parts(self) -> list[tuple[Candidate, np.ndarray]]:
        """Return each candidate with the values of its terms."""
        ends = np.cumsum([len(one.terms) for one in self.candidates[:-1]], dtype=int)
        return list(zip(self.candidates, np.split(self.values, ends), strict=False))

    @property
    def total(self) -> float:
        """Loss on held-out recordings."""
        return float(self.held_out.sum()) + self.pose_held_out

    @property
    def inside(self) -> float:
        """Loss on the recordings it was fitted on."""
        return float(self.loss.sum()) + self.pose_loss

    def shift(self, model: Model) -> np.ndarray:
        """Return what the effects change, (R, SIZE)."""
        return model.predict(self.candidates, np.tile(self.values, (len(model.gap), 1)))[0]

    def residual(self, model: Model) -> np.ndarray:
        """Return what the effects and nuisances leave of the gap, (R, SIZE)."""
        values = np.tile(self.values, (len(model.gap), 1))
        columns, shift = model.nuisance_columns(self.candidates, values)
        return model.gap - shift - model.sigma_shift(self.sigma) - combine(self.nuisances, columns)


@dataclass(frozen=True)
class _Problem:
    # What stays the same in all steps: candidates, bounds of their values and of sigma's error,
    # whether the recordings may have a pose error in common.
    model: Model
    candidates: tuple[Candidate, ...]
    low: np.ndarray
    high: np.ndarray
    sigma_bound: float
    common_pose: bool

    def tiled(self, values: np.ndarray) -> np.ndarray:
        return np.tile(values, (len(self.model.gap), 1))


@dataclass(frozen=True)
class _Estimate:
    values: np.ndarray
    sigma: float
    nuisances: np.ndarray


def fit(
    model: Model,
    candidates: Sequence[Candidate],
    start: np.ndarray | None = None,
    scales: Sequence[float] | None = None,
) -> Fit:
    """
    Fit a set of candidates robustly, and again without each recording.

    No candidates fit the base simulator alone. (n,) `start` is neutral when left out. `scales` is
    the scale of the loss in each step, in units of the features' own; at least one. It shrinks
    from step to step, so that a far start does not make outliers of all features: Blake and
    Zisserman, Visual Reconstruction, 1987 (graduated non-convexity).
    """
    problem = _problem(model, candidates)
    terms = [term for candidate in candidates for term in candidate.terms]
    values = np.array([t.neutral for t in terms]) if start is None else np.array(start, float)
    now = _Estimate(values, 0.0, np.zeros((len(model.gap), model.own.count)))
    about = model.constants
    for scale in scales or about.scales:
        before, equations = now, _equations(problem, now, scale)
        now = _step(problem, before, equations)
    left_out = np.clip(
        before.values + leave_one_out_steps(equations, now.sigma - before.sigma),
        problem.low,
        problem.high,
    )
    loss, nuisances = _refit_nuisances(problem, problem.tiled(now.values), now)
    now = _Estimate(now.values, now.sigma, nuisances)
    held_out, others = _refit_nuisances(problem, left_out, now)
    sigma_loss = about.sigma_weight * (now.sigma / about.sigma_spread) ** 2
    common = problem.common_pose
    return Fit(
        problem.candidates,
        now.values,
        left_out,
        now.sigma,
        nuisances,
        loss,
        held_out,
        model.own.loss(nuisances, common) + sigma_loss,
        model.own.loss(others, common, held_out=True) + sigma_loss,
    )


def nuisances_of(model: Model, one: Fit) -> np.ndarray:
    """
    Return the nuisances of each recording, (R, N), with the shared values of the fit `one`.

    The fit's own nuisances are the start. The model's scale of the loss may be another than that
    of the fit.
    """
    problem = _problem(model, one.candidates)
    nuisances = one.nuisances
    for _ in model.constants.scales:
        now = _Estimate(one.values, one.sigma, nuisances)
        nuisances = _refit_nuisances(problem, problem.tiled(one.values), now)[1]
    return nuisances


def losses_at(model: Model, one: Fit) -> np.ndarray:
    """Return each recording's loss, (R,), at the values of a fit; nuisances are fitted again."""
    problem = _problem(model, one.candidates)
    now = _Estimate(one.values, one.sigma, one.nuisances)
    return _refit_nuisances(problem, problem.tiled(one.values), now)[0]


def _problem(model: Model, candidates: Sequence[Candidate]) -> _Problem:
    terms = [term for candidate in candidates for term in candidate.terms]
    roles = {candidate.kind.role for candidate in candidates}
    return _Problem(
        model,
        tuple(candidates),
        np.array([t.low for t in terms]),
        np.array([t.high for t in terms]),
        # Excess noise and a wrong base sigma are the same thing: only one of them is free.
        0.0 if 'sigma' in roles else model.constants.sigma_bound,
        'pose' in roles,
    )


def _equations(problem: _Problem, now: _Estimate, scale: float) -> SharedEquations:
    # One reweighting: all values' equations around the present estimate. Shared are the terms'
    # values and, last, the error of sigma.
    model = problem.model
    tiled = problem.tiled(now.values)
    _, slopes = model.predict(problem.candidates, tiled)
    own_columns, shift = model.nuisance_columns(problem.candidates, tiled)
    residual = model.gap - shift - model.sigma_shift(now.sigma)
    residual = residual - combine(now.nuisances, own_columns)
    sigma_column = model.sigma_column(now.sigma)
    design = np.concatenate([slopes, sigma_column[:, None], own_columns], axis=1)
    wide2 = model.wide2(shift) * np.float32(scale**2)
    weight = cauchy_weights(model.weights, residual, wide2)
    normal, right = normal_equations(design, weight, residual)
    terms, shared = slopes.shape[1], slopes.shape[1] + 1
    stiffness, pull = model.own.prior(now.nuisances, problem.common_pose)
    normal[:, shared:, shared:] += stiffness
    right[:, shared:] -= pull
    equations = eliminate_nuisances(normal, right, shared)
    # Sigma's prior is split among the recordings, so that fits without one of them have it too.
    about = model.constants
    sigma_stiffness = about.sigma_weight / about.sigma_spread**2 / len(model.gap)
    equations.normal[:, terms, terms] += sigma_stiffness
    equations.right[:, terms] -= sigma_stiffness * now.sigma
    return equations


def _step(problem: _Problem, now: _Estimate, equations: SharedEquations) -> _Estimate:
    # One step of least squares, within bounds.
    normal, right = equations.normal.sum(axis=0), equations.right.sum(axis=0)
    step, bound = solve(normal, right), problem.sigma_bound
    values = np.clip(now.values + step[:-1], problem.low, problem.high)
    sigma = float(np.clip(now.sigma + step[-1], -bound, bound))
    if abs(sigma) == bound and len(values):
        # Sigma's error is held at its bound: solve for the rest again.
        rest = solve_given_last(normal, right, sigma - now.sigma)
        values = np.clip(now.values + rest, problem.low, problem.high)
    moved = np.concatenate([values - now.values, [sigma - now.sigma]])
    return _Estimate(values, sigma, now.nuisances + equations.nuisance_step(moved))


def _refit_nuisances(
    problem: _Problem, values: np.ndarray, now: _Estimate
) -> tuple[np.ndarray, np.ndarray]:
    # Each recording's loss and nuisances at (R, n) values, the nuisances fitted again.
    model, nuisances = problem.model, now.nuisances
    columns, shift = model.nuisance_columns(problem.candidates, values)
    gap, wide2 = model.gap - shift - model.sigma_shift(now.sigma), model.wide2(shift)
    for _ in range(model.constants.nuisance_steps):
        residual = gap - combine(nuisances, columns)
        weight = cauchy_weights(model.weights, residual, wide2)
        stiffness, pull = model.own.prior(nuisances, problem.common_pose)
        normal, right = normal_equations(columns, weight, residual)
        step = np.linalg.solve(normal + stiffness, (right - pull)[..., None])
        nuisances = nuisances + step[..., 0]
    return model.losses(gap - combine(nuisances, columns), shift), nuisances

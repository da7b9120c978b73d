"""
Poses of many recordings and the errors that they share, estimated together.

A pose that is fitted alone absorbs most of a bias and of wiggling. The errors of a camera are the
same in all recordings, the poses are not. Four recordings or more therefore distinguish them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from flexx2_sim_ros.truth.alignment import clamped, Linear, PosedImage
from flexx2_sim_ros.truth.columns import ErrorColumns, PRIOR
from flexx2_sim_ros.truth.solver import minimise, tile_sums
import numpy as np

_ROUNDS = 6  # Gauss-Newton steps, at most
_CONVERGED = 1e-6


@dataclass(frozen=True)
class Solution:
    """
    The solution for all recordings.

    * `values`: (k,) coefficients.
    * `deviations`: (k,) standard deviations: the larger of the one from the pixels and the one
      from leaving out one recording at a time.
    * `condition`: condition number of the coefficients' equations, scaled to a unit diagonal.
    * `views`: the views with their new poses.
    * `covariances`: (6, 6) each, of the views' motions (metres, radians).
    * `drags`: (6,) each: the pose error that a bias of one prior standard deviation causes if the
      bias is not estimated.
    * `recordings`: how many of them the views are of.
    """

    columns: ErrorColumns
    values: np.ndarray
    deviations: np.ndarray
    condition: float
    views: tuple[PosedImage, ...]
    covariances: tuple[np.ndarray, ...]
    drags: tuple[np.ndarray, ...]
    recordings: int

    def full_covariance(self, view: int) -> np.ndarray:
        """Return the (6, 6) covariance of a pose, including a bias that is not estimated."""
        drag = self.drags[view] * (not self.columns.bias)
        return self.covariances[view] + np.outer(drag, drag)


@dataclass(frozen=True)
class _Joint:
    # All views and their coefficients, which are those of each view, too; a `State`.
    views: tuple[PosedImage, ...]
    columns: ErrorColumns
    values: np.ndarray

    @cached_property
    def equations(self) -> list[Linear]:
        return [view.linear for view in self.views]

    def step(self, damping: float) -> np.ndarray:
        # Each pose depends on the coefficients only: they come first.
        values = np.linalg.solve(*reduced(self.equations, self.columns))
        motions = [
            clamped(np.linalg.solve(one.H, one.g - one.B @ values)) for one in self.equations
        ]
        return np.concatenate([values - self.values, *motions])

    def moved(self, step: np.ndarray) -> '_Joint':
        k = len(self.values)
        values = self.values + step[:k]
        views = (
            replace(view.moved(motion), values=values)
            for view, motion in zip(self.views, step[k:].reshape(-1, 6), strict=True)
        )
        return replace(self, views=tuple(views), values=values)

    def loss(self, other: '_Joint') -> float:
        return 0.0  # Whatever a step does to the weights, it counts.


def solve(views: Sequence[PosedImage], columns: ErrorColumns) -> Solution:
    """Estimate poses and shared coefficients together, from approximately correct poses."""
    values = np.zeros(len(columns.names))
    seen = tuple(replace(view, columns=columns, values=values) for view in views)
    start = _Joint(seen, columns, values)
    return _finish(minimise(start, _ROUNDS, _CONVERGED, 0.0))


def reduced(equations: Sequence[Linear], columns: ErrorColumns) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of the coefficients, without poses (Schur complement)."""
    S, s = np.diag(columns.precision), np.zeros(len(columns.names))
    for one in equations:
        part, side = _share(one)
        S, s = S + part, s + side
    return S, s


def _share(one: Linear) -> tuple[np.ndarray, np.ndarray]:
    free = one.free(one.A)
    return (free * one.weight[:, None]).T @ one.A, free.T @ (one.weight * one.y)


def _finish(found: _Joint) -> Solution:
    views, columns, values, equations = found.views, found.columns, found.values, found.equations
    shares = [_share(one) for one in equations]
    k = len(values)
    prior = np.diag(columns.precision)
    S = prior + sum((part for part, _ in shares), np.zeros((k, k)))
    s = sum((side for _, side in shares), np.zeros(k))
    inverse = np.linalg.inv(S) if k else S
    owners = np.array([view.recording for view in views])
    left_out = []
    for recording in np.unique(owners):
        mine = [shares[i] for i in np.flatnonzero(owners == recording)]
        S_rest = S - sum((part for part, _ in mine), np.zeros((k, k)))
        left_out.append(np.linalg.solve(S_rest, s - sum((side for _, side in mine), np.zeros(k))))
    apart = np.array(left_out).reshape(len(left_out), k)
    count = max(len(apart), 1)  # There may be no view, where the camera is lost in all recordings.
    middle = apart.sum(axis=0) / count
    jackknife = np.sqrt((count - 1) / count * ((apart - middle) ** 2).sum(axis=0))
    scores = [_tile_scores(one, values) for one in equations]
    meat = prior + sum((own.T @ own for _, own in scores), np.zeros((k, k)))
    spread = inverse @ meat @ inverse
    poses, drags = [], []
    for one, (g, own) in zip(equations, scores, strict=True):
        H_inverse = np.linalg.inv(one.H)
        pull = H_inverse @ one.B
        here = g @ H_inverse - own @ inverse @ pull.T
        others = spread - inverse @ (own.T @ own) @ inverse
        poses.append(here.T @ here + pull @ others @ pull.T)
        drags.append(PRIOR * H_inverse @ (one.J.T @ (one.weight * one.bias)))
    data = S - prior
    scale = np.sqrt(np.maximum(np.diag(data), 1e-30))
    condition = float(np.linalg.cond(data / np.outer(scale, scale))) if k else 1.0
    return Solution(
        columns,
        values,
        np.maximum(jackknife, np.sqrt(np.diag(spread))),
        condition,
        views,
        tuple(poses),
        tuple(drags),
        len(apart),
    )


def _tile_scores(one: Linear, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Sums over each tile: (tiles, 6) for the pose, (tiles, k) for the coefficients.
    motion = np.linalg.solve(one.H, one.g - one.B @ values)
    left = one.weight * (one.y - one.A @ values - one.J @ motion)
    g, own = one.J * left[:, None], one.free(one.A) * left[:, None]
    return tile_sums(one.tile, g), tile_sums(one.tile, own)

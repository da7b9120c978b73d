"""
Poses of many recordings and the errors that they share, or one motion of all, fitted together.

A pose that is fitted alone absorbs most of a bias and of wiggling. The errors of a camera are the
same in all recordings, the poses are not. Four recordings or more therefore distinguish them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math

from flexx2_sim_ros.physics.poses import (
    eliminate_nuisances,
    Pose,
    SharedEquations,
    weighted_equations,
)
from flexx2_sim_ros.truth.alignment import (
    clamped,
    ErrorColumns,
    Linear,
    NO_ERRORS,
    PosedImage,
    PRIOR,
)
from flexx2_sim_ros.truth.solver import minimise, tile_sums, TRUNCATION
import numpy as np

_ROUNDS = 6  # Gauss-Newton steps, at most
_CONVERGED = 1e-6
# Of the motion of all: steps, the least one.
_STEPS, _LEAST_STEP = 15, 1e-5
# Standard deviations of priors: the motion (metres, radians), a latency (seconds). ASSUMED
_PRIOR = 0.3, math.radians(20), 1.0
_CLEAR = 5.0  # standard deviations
_REACH = 0.5  # metres: poses may be far off
# Costs, 0 to 1: the room is what the recordings show, and much better so. ASSUMED
_MOST_COST, _BETTER = 0.2, 0.5


@dataclass(frozen=True)
class Solution:
    """The solution for all recordings."""

    columns: ErrorColumns
    values: np.ndarray  # (k,) coefficients
    # (k,) standard deviations: the larger of the one from the pixels and the one from leaving out
    # one recording at a time.
    deviations: np.ndarray
    views: tuple[PosedImage, ...]  # with their new poses
    covariances: tuple[np.ndarray, ...]  # (6, 6) each, of the views' motions (metres, radians)
    # (6,) each: the pose error by a bias of one prior standard deviation that is not estimated.
    drags: tuple[np.ndarray, ...]

    @property
    def recordings(self) -> int:
        """Return how many recordings the views are of."""
        return len({view.recording for view in self.views})

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
    def shared(self) -> SharedEquations:
        return shared_equations([view.linear for view in self.views], self.columns)

    def step(self, damping: float) -> np.ndarray:
        # Each pose depends on the coefficients only: they come first.
        values = np.linalg.solve(*reduced(self.shared, self.columns))
        motions = map(clamped, self.shared.nuisance_step(values))
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


def shared_equations(equations: Sequence[Linear], columns: ErrorColumns) -> SharedEquations:
    """Return the equations of the coefficients by each view, without its pose."""
    k = len(columns.names)
    normal = np.array([one.equations[0] for one in equations]).reshape(-1, k + 6, k + 6)
    right = np.array([one.equations[1] for one in equations]).reshape(-1, k + 6)
    return eliminate_nuisances(normal, right, k)


def reduced(shared: SharedEquations, columns: ErrorColumns) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of the coefficients by all views, with their prior."""
    return np.diag(columns.precision) + shared.normal.sum(axis=0), shared.right.sum(axis=0)


def _finish(found: _Joint) -> Solution:
    views, columns, values, shared = found.views, found.columns, found.values, found.shared
    S, s = reduced(shared, columns)
    inverse = np.linalg.inv(S)
    owners = np.array([view.recording for view in views])
    left_out = [
        np.linalg.solve(S - shared.normal[mine].sum(axis=0), s - shared.right[mine].sum(axis=0))
        for mine in (owners == recording for recording in np.unique(owners))
    ]
    apart = np.array(left_out).reshape(len(left_out), len(values))
    count = max(len(apart), 1)  # There may be no view, where the camera is lost in all recordings.
    middle = apart.sum(axis=0) / count
    jackknife = np.sqrt((count - 1) / count * ((apart - middle) ** 2).sum(axis=0))
    motions = shared.nuisance_step(values)
    scores = [
        _tile_scores(view.linear, values, motion)
        for view, motion in zip(views, motions, strict=True)
    ]
    meat = np.diag(columns.precision) + sum(own.T @ own for _, own in scores)
    spread = inverse @ meat @ inverse
    poses, drags = [], []
    for view, (g, own), free, mixed in zip(
        views, scores, shared.inverse, shared.mixed, strict=True
    ):
        one, pull = view.linear, free @ mixed
        here = g @ free - own @ inverse @ pull.T
        others = spread - inverse @ (own.T @ own) @ inverse
        poses.append(here.T @ here + pull @ others @ pull.T)
        drags.append(PRIOR * free @ (one.J.T @ (one.weight * one.bias)))
    return Solution(
        columns,
        values,
        np.maximum(jackknife, np.sqrt(np.diag(spread))),
        views,
        tuple(poses),
        tuple(drags),
    )


def _tile_scores(
    one: Linear, values: np.ndarray, motion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    # Sums over each tile: (tiles, 6) for the pose, (tiles, k) for the coefficients.
    left = one.weight * (one.y - one.A @ values - one.J @ motion)
    g, own = one.J * left[:, None], one.free(one.A) * left[:, None]
    return tile_sums(one.tile, g), tile_sums(one.tile, own)


def common_motion(views: Sequence[PosedImage], covariance: np.ndarray, mount: Pose) -> str:
    """
    Return by which motion of the camera in its body given poses are off; nothing if it is unclear.

    `covariance` (6, 6) is that of the poses; `mount` where the camera is in the body, as given.
    """
    if not any(len(view.linear.y) for view in views):
        return ''
    motion, variance, seen = fitted_motion(views)
    clear = (np.abs(motion) > _CLEAR * np.sqrt(variance + np.diag(covariance))).any()
    before, after = (
        float(np.mean([replace(view, reach=TRUNCATION).cost for view in some]))
        for some in (views, seen)
    )
    if not clear or after > min(_MOST_COST, _BETTER * before):
        return ''
    metres, turn = np.linalg.norm(motion[:3]), math.degrees(np.linalg.norm(motion[3:]))
    better = ','.join(f'{number:.4g}' for number in mount.moved(motion).numbers())
    return (
        f'the given poses are all off by {metres * 1e3:.0f} mm and {turn:.1f} degrees: measure '
        f'--camera-in-body again (what the recordings show: {better})'
    )


def fitted_motion(views: Sequence[PosedImage]) -> tuple[np.ndarray, np.ndarray, list[PosedImage]]:
    """
    Return the (6,) motion of the camera in its body that fits best, its variances, the views so.

    A latency and a bias of the camera are fitted with it.
    """
    bounce = any(view.target.bounce.any() for view in views)
    columns = replace(NO_ERRORS, bias=True, bounce=bounce)
    precision = np.concatenate([np.repeat(_PRIOR, [3, 3, 1]) ** -2.0, columns.precision])
    values = np.zeros(len(precision))
    for _ in range(_STEPS):
        seen = [
            replace(
                view,
                pose=view.pose.moved(values[:6] - values[6] * view.speed),
                columns=columns,
                values=values[7:],
                reach=_REACH,
            )
            for view in views
        ]
        parts = [
            (np.column_stack([one.J, -one.J @ view.speed, one.A]), one, one.y - one.A @ values[7:])
            for view in seen
            for one in [view.linear]
        ]
        J, left = (np.concatenate([part[k] for part in parts]) for k in (0, 2))
        weight = np.concatenate([one.weight for _, one, _ in parts])
        normal, right = weighted_equations(J.T, weight, left)
        normal += np.diag(precision)
        step = np.linalg.solve(normal, right - precision * values)
        step[:6] = clamped(step[:6])
        values = values + step
        if np.abs(step).max() < _LEAST_STEP:
            break
    inverse = np.linalg.inv(normal)
    # Errors within a tile are not independent.
    pulls = (tile_sums(one.tile, J * (one.weight * y)[:, None]) for J, one, y in parts)
    score = np.vstack([*pulls])
    spread = inverse @ (score.T @ score + np.diag(precision)) @ inverse
    return values[:6], np.diag(spread)[:6], seen

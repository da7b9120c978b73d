"""
Poses of many recordings and the errors that they share, or one motion of all, fitted together.

A pose that is fitted alone absorbs most of a bias and of wiggling. The errors of a camera are the
same in all recordings, the poses are not. Four recordings or more therefore distinguish them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math

from flexx2_sim_ros.truth.alignment import (
    clamped,
    ErrorColumns,
    Linear,
    NO_ERRORS,
    PosedImage,
    PRIOR,
)
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.solver import damped_step, information, minimise, tile_sums, TRUNCATION
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
    k, prior = len(values), np.diag(columns.precision)
    shares = [_share(one) for one in equations]
    parts = np.array([part for part, _ in shares]).reshape(len(shares), k, k)
    sides = np.array([side for _, side in shares]).reshape(len(shares), k)
    S, s = prior + parts.sum(axis=0), sides.sum(axis=0)
    inverse = np.linalg.inv(S)
    owners = np.array([view.recording for view in views])
    left_out = [
        np.linalg.solve(S - parts[mine].sum(axis=0), s - sides[mine].sum(axis=0))
        for mine in (owners == recording for recording in np.unique(owners))
    ]
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
    return Solution(
        columns,
        values,
        np.maximum(jackknife, np.sqrt(np.diag(spread))),
        views,
        tuple(poses),
        tuple(drags),
    )


def _tile_scores(one: Linear, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Sums over each tile: (tiles, 6) for the pose, (tiles, k) for the coefficients.
    motion = np.linalg.solve(one.H, one.g - one.B @ values)
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
    values, eye = np.zeros(len(precision)), np.eye(len(precision))
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
        weights = np.concatenate([weight, precision])
        step = damped_step(np.vstack([J, eye]), weights, np.concatenate([left, -values]), 0.0)
        step[:6] = clamped(step[:6])
        values = values + step
        if np.abs(step).max() < _LEAST_STEP:
            break
    inverse = np.linalg.inv(information(J, weight) + np.diag(precision))
    # Errors within a tile are not independent.
    pulls = (tile_sums(one.tile, J * (one.weight * y)[:, None]) for J, one, y in parts)
    score = np.vstack([*pulls])
    spread = inverse @ (score.T @ score + np.diag(precision)) @ inverse
    return values[:6], np.diag(spread)[:6], seen

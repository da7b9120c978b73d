"""
Poses of many recordings and the errors that they share, estimated together.

A pose that is fitted alone absorbs most of a bias and of wiggling. The errors of a camera are the
same in all recordings, the poses are not. Four recordings or more therefore distinguish them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

from flexx2_sim_ros.truth.alignment import (
    AlignedPixels,
    clamped,
    facing,
    jacobian,
    residuals,
    robust_weights,
    TRUNCATION,
)
from flexx2_sim_ros.truth.columns import error_columns, ErrorColumns, LENS, PRIOR
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.rooms import Hits
import numpy as np

_ROUNDS = 6  # Gauss-Newton steps, at most
_CONVERGED = 1e-6
_POSE_PRIOR = 1.0  # 1/m2: keeps the equations regular if the recording does not determine the pose


@dataclass(frozen=True)
class PosedImage:
    """
    One image with its pose.

    Attributes
    ----------
    recording : int
        Number of its recording.
    room : pathlib.Path
        The room's file; see `load_room`.
    target : AlignedPixels
        Its pixels.
    pose : Pose
    bounce : numpy.ndarray
        (N,) simulated depth error of each pixel by light that bounced once, metres.
    uptime : float
        Seconds since the camera was switched on; infinite if unknown.

    """

    recording: int
    room: Path
    target: AlignedPixels
    pose: Pose
    bounce: np.ndarray
    uptime: float = math.inf


@dataclass(frozen=True)
class Linear:
    """
    The weighted linear equations of a view: y = J motion + A coefficients.

    Attributes
    ----------
    J, A, y, weight : numpy.ndarray
        (N, 6), (N, k), (N,), (N,).
    tile : numpy.ndarray
        (N,) see `AlignedPixels`.
    bias : numpy.ndarray
        (N,) depth error by a bias of 1 m along the ray.

    """

    J: np.ndarray
    A: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    tile: np.ndarray
    bias: np.ndarray

    @property
    def H(self) -> np.ndarray:  # noqa: N802
        """Return the (6, 6) information of the pose alone."""
        return (self.J * self.weight[:, None]).T @ self.J + _POSE_PRIOR * np.eye(6)

    @property
    def B(self) -> np.ndarray:  # noqa: N802
        """Return (6, k), pose against coefficients."""
        return (self.J * self.weight[:, None]).T @ self.A

    @property
    def g(self) -> np.ndarray:
        """Return (6,), the right side of the pose."""
        return self.J.T @ (self.weight * self.y)

    def free(self, columns: np.ndarray) -> np.ndarray:
        """Return (N, m) columns without the part that a motion of the camera explains."""
        return columns - self.J @ np.linalg.solve(
            self.H, (self.J * self.weight[:, None]).T @ columns
        )


@dataclass(frozen=True)
class Solution:
    """
    The solution for all recordings.

    Attributes
    ----------
    columns : ErrorColumns
    values : numpy.ndarray
        (k,) coefficients.
    deviations : numpy.ndarray
        (k,) standard deviations: the larger of the one from the pixels and the one from leaving
        out one recording at a time.
    condition : float
        Condition number of the coefficients' equations, scaled to a unit diagonal.
    views : tuple of PosedImage
        The views with their new poses.
    covariances : tuple of numpy.ndarray
        (6, 6) each, of the views' motions (metres, radians).
    drags : tuple of numpy.ndarray
        (6,) each: the pose error that a bias of one prior standard deviation causes if the bias is
        not estimated.
    recordings : int
        How many of them the views are of.
    free : tuple of float
        Metres: how far each view can move along its least certain axis, by its pixels alone.

    """

    columns: ErrorColumns
    values: np.ndarray
    deviations: np.ndarray
    condition: float
    views: tuple[PosedImage, ...]
    covariances: tuple[np.ndarray, ...]
    drags: tuple[np.ndarray, ...]
    recordings: int
    free: tuple[float, ...] = ()

    def full_covariance(self, view: int) -> np.ndarray:
        """Return the (6, 6) covariance of a pose, including a bias that is not estimated."""
        drag = self.drags[view] * (not self.columns.bias)
        return self.covariances[view] + np.outer(drag, drag)


def linearise(view: PosedImage, columns: ErrorColumns, values: np.ndarray) -> Linear:
    """Return a view's equations at its pose and these coefficients, with robust weights."""
    rays = columns.true_rays(values, view.target.rays)
    hits = load_room(view.room).cast(view.pose, rays)
    y = residuals(hits, view.target)
    use = facing(hits, view.target) & np.isfinite(y)
    chosen = view.target.picked(use)
    rays, y = rays[use], y[use]
    kept = Hits(hits.depth[use], hits.normal[use], None, hits.border[use])
    A = error_columns(columns, kept, rays, view.bounce[use], view.uptime)
    # The rays have the errors of the lens already.
    y += A @ np.where(np.isin(columns.names, tuple(LENS)), values, 0)
    weight = robust_weights(y - A @ values, chosen.sigma**2, TRUNCATION)
    J = jacobian(kept, rays)
    return Linear(J, A, y, weight, chosen.tile, 1 / chosen.length)


def solve(views: Sequence[PosedImage], columns: ErrorColumns) -> Solution:
    """Estimate poses and shared coefficients together, from approximately correct poses."""
    values = np.zeros(len(columns.names))
    current = list(views)
    for _ in range(_ROUNDS):
        equations = [linearise(view, columns, values) for view in current]
        S, s = reduced(equations, columns)
        values = np.linalg.solve(S, s)
        longest = 0.0
        for i, one in enumerate(equations):
            step = clamped(np.linalg.solve(one.H, one.g - one.B @ values))
            current[i] = replace(current[i], pose=current[i].pose.moved(step))
            longest = max(longest, float(np.abs(step).max()))
        if longest < _CONVERGED:
            break
    return _finish(current, columns, values)


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


def _finish(views: list[PosedImage], columns: ErrorColumns, values: np.ndarray) -> Solution:
    equations = [linearise(view, columns, values) for view in views]
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
    poses, drags, free = [], [], []
    for one, (g, own) in zip(equations, scores, strict=True):
        H_inverse = np.linalg.inv(one.H)
        pull = H_inverse @ one.B
        here = g @ H_inverse - own @ inverse @ pull.T
        others = spread - inverse @ (own.T @ own) @ inverse
        poses.append(here.T @ here + pull @ others @ pull.T)
        free.append(float(np.sqrt(np.linalg.eigvalsh(H_inverse[:3, :3])[-1])))
        drags.append(PRIOR * H_inverse @ (one.J.T @ (one.weight * one.bias)))
    data = S - prior
    scale = np.sqrt(np.maximum(np.diag(data), 1e-30))
    condition = float(np.linalg.cond(data / np.outer(scale, scale))) if k else 1.0
    return Solution(
        columns,
        values,
        np.maximum(jackknife, np.sqrt(np.diag(spread))),
        condition,
        tuple(views),
        tuple(poses),
        tuple(drags),
        len(apart),
        tuple(free),
    )


def _tile_scores(one: Linear, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Sums over each tile: (tiles, 6) for the pose, (tiles, k) for the coefficients.
    motion = np.linalg.solve(one.H, one.g - one.B @ values)
    left = one.weight * (one.y - one.A @ values - one.J @ motion)
    tiles = int(one.tile.max(initial=-1)) + 1
    g, own = np.zeros((tiles, 6)), np.zeros((tiles, len(values)))
    np.add.at(g, one.tile, one.J * left[:, None])
    np.add.at(own, one.tile, one.free(one.A) * left[:, None])
    return g, own

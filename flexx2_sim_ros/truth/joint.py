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
    clamped,
    facing,
    jacobian,
    residuals,
    robust_weights,
    Target,
    TRUNCATION,
)
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.rooms import Hits
import numpy as np

# Standard deviations of the priors: bias, drift and amplitudes in metres; gain of the bounce.
_PRIOR = 0.02
_PRIOR_GAIN = 1.0
_PRIOR_SCALE = 0.005  # scale error of a scan; photogrammetry without a measured length is worse
# Errors of the lens: relative error of the focal length; principal point, as tangents of angles
# (about 4 pixels of 224); radial distortion.
LENS = {'focal': 0.02, 'cx': 0.02, 'cy': 0.02, 'k1': 0.05}
_ROUNDS = 6
_INVERSIONS = 4  # of distortion: enough for a tenth of a pixel
_CONVERGED = 1e-6
_POSE_PRIOR = 1.0  # 1/m2: keeps the equations regular if the recording does not determine the pose


@dataclass(frozen=True)
class View:
    """
    One image with its pose.

    Attributes
    ----------
    recording : int
        Number of its recording.
    room : pathlib.Path
        The room's file; see `load_room`.
    target : Target
        Its pixels.
    pose : Pose
    bounce : numpy.ndarray
        (N,) simulated depth error of each pixel by light that bounced once, metres.
    uptime : float
        Seconds since the camera was switched on; infinite if unknown.

    """

    recording: int
    room: Path
    target: Target
    pose: Pose
    bounce: np.ndarray
    uptime: float = math.inf


@dataclass(frozen=True)
class Columns:
    """
    The errors that all recordings share, in the order of the coefficients.

    Attributes
    ----------
    bias : bool
        Whether a constant along the ray (metres) is fitted.
    periods : tuple of float
        Periods of wiggling along the range, metres; each has a sine and a cosine.
    bounce : bool
        Whether a gain of the light that bounced once is fitted.
    scale : bool
        Whether a relative scale of depth against the room is fitted.
    lens : bool
        Whether errors of the lens are fitted: focal length, principal point and distortion.
    drift : float
        Time constant of a bias along the ray that decays after power-on, seconds; 0: not fitted.

    """

    bias: bool = True
    periods: tuple[float, ...] = ()
    bounce: bool = True
    scale: bool = False
    lens: bool = False
    drift: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        waves = [
            f'{part} {period:.3f} m' for period in self.periods for part in ('sine', 'cosine')
        ]
        return (
            *['bias'] * self.bias,
            *waves,
            *['scale'] * self.scale,
            *tuple(LENS) * self.lens,
            *['drift'] * bool(self.drift),
            *['bounce'] * self.bounce,
        )

    @property
    def precision(self) -> np.ndarray:
        """Return the priors' inverse variances."""
        own = {'bounce': _PRIOR_GAIN, 'scale': _PRIOR_SCALE, **LENS}
        deviations = [own.get(name, _PRIOR) for name in self.names]
        return np.array(deviations, float) ** -2.0

    def true_rays(self, values: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """
        Return the rays along which a camera with these errors of its lens sees.

        Parameters
        ----------
        values : numpy.ndarray
            (k,) coefficients.
        rays : numpy.ndarray
            (N, 2) x/z and y/z as the given lens has them.

        """
        if not self.lens:
            return rays
        focal, cx, cy, k1 = values[[self.names.index(name) for name in LENS]]
        image = (rays - (cx, cy)) / (1 + focal)
        true = image
        for _ in range(_INVERSIONS):
            true = image / (1 + k1 * (true**2).sum(axis=-1, keepdims=True))
        return true

    def errors(
        self, values: np.ndarray, hits: Hits, rays: np.ndarray, bounce: np.ndarray, uptime: float
    ) -> np.ndarray:
        """Return the (N,) depth errors but for those of the lens; arguments as `error_columns`."""
        part = replace(self, lens=False)
        own = [i for i, name in enumerate(self.names) if name not in LENS]
        return np.asarray(error_columns(part, hits, rays, bounce, uptime) @ values[own])


def error_columns(
    columns: Columns, hits: Hits, rays: np.ndarray, bounce: np.ndarray, uptime: float
) -> np.ndarray:
    """
    Return the depth error per unit of each coefficient.

    Parameters
    ----------
    columns : Columns
        The errors.
    hits : Hits
        (N,) surfaces that the rays should hit.
    rays : numpy.ndarray
        (N, 2) x/z and y/z.
    bounce : numpy.ndarray
        (N,) as in `View`.
    uptime : float
        As in `View`.

    Returns
    -------
    numpy.ndarray
        (N, k) metres along the optical axis.

    """
    depth, length = hits.depth, np.sqrt(1 + (rays**2).sum(axis=-1))
    parts = [1 / length] if columns.bias else []
    for period in columns.periods:
        turn = 2 * np.pi * depth * length / period
        parts += [np.sin(turn) / length, np.cos(turn) / length]
    if columns.scale:
        parts.append(depth)
    if columns.lens:
        parts += _lens_columns(hits, rays)
    if columns.drift:
        parts.append(math.exp(-uptime / columns.drift) / length)
    if columns.bounce:
        parts.append(bounce)
    return np.stack(parts, axis=-1) if parts else np.zeros((len(depth), 0))


def _lens_columns(hits: Hits, rays: np.ndarray) -> list[np.ndarray]:
    # Coefficients as of LENS: those of the true lens minus those given. Each bends the rays.
    x, y = rays.T
    with np.errstate(invalid='ignore', divide='ignore'):
        across, down = -hits.depth * hits.normal[:, :2].T / hits.slant(rays)  # per change of a ray
    outwards = across * x + down * y
    return [-outwards, -across, -down, -outwards * (x**2 + y**2)]


@dataclass(frozen=True)
class Linear:
    """
    The weighted linear equations of a view: y = J motion + A coefficients.

    Attributes
    ----------
    J, A, y, weight : numpy.ndarray
        (N, 6), (N, k), (N,), (N,).
    tile : numpy.ndarray
        (N,) see `Target`.
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
    columns : Columns
    values : numpy.ndarray
        (k,) coefficients.
    deviations : numpy.ndarray
        (k,) standard deviations: the larger of the one from the pixels and the one from leaving
        out one recording at a time.
    condition : float
        Condition number of the coefficients' equations, scaled to a unit diagonal.
    views : tuple of View
        The views with their new poses.
    covariances : tuple of numpy.ndarray
        (6, 6) each, of the views' motions (metres, radians).
    drags : tuple of numpy.ndarray
        (6,) each: the pose error that a bias of one prior standard deviation causes if the bias is
        not estimated.
    left_out : numpy.ndarray
        (R, k) coefficients without each recording.

    """

    columns: Columns
    values: np.ndarray
    deviations: np.ndarray
    condition: float
    views: tuple[View, ...]
    covariances: tuple[np.ndarray, ...]
    drags: tuple[np.ndarray, ...]
    left_out: np.ndarray

    def full_covariance(self, view: int) -> np.ndarray:
        """Return the (6, 6) covariance of a pose, including a bias that is not estimated."""
        drag = self.drags[view] * (not self.columns.bias)
        return self.covariances[view] + np.outer(drag, drag)


def linearise(
    view: View, columns: Columns, values: np.ndarray
) -> tuple[Linear, Target, np.ndarray]:
    """
    Return a view's equations at its pose, with robust weights of the residuals.

    Parameters
    ----------
    view : View
        The view.
    columns : Columns
        Which errors are shared.
    values : numpy.ndarray
        (k,) present coefficients.

    Returns
    -------
    tuple
        The equations, the pixels in them, and the depth expected at each, metres.

    """
    rays = columns.true_rays(values, view.target.rays)
    hits = load_room(view.room).cast(view.pose, rays)
    y = residuals(hits, view.target)
    use = facing(hits, view.target) & np.isfinite(y)
    chosen = replace_target(view.target, use)
    rays, y = rays[use], y[use]
    kept = _pick(hits, use)
    A = error_columns(columns, kept, rays, view.bounce[use], view.uptime)
    # The rays have the errors of the lens already.
    y += A @ np.where(np.isin(columns.names, tuple(LENS)), values, 0)
    weight = robust_weights(y - A @ values, chosen.sigma**2, TRUNCATION)
    J = jacobian(kept, rays)
    return Linear(J, A, y, weight, chosen.tile, 1 / chosen.length), chosen, kept.depth


def replace_target(target: Target, use: np.ndarray) -> Target:
    """Return the pixels of a target that an (N,) bool array picks."""
    picked = {
        name: getattr(target, name)[use]
        for name in ('rays', 'depth', 'sigma', 'length', 'pixel', 'tile')
    }
    return replace(target, **picked)


def _pick(hits: Hits, use: np.ndarray) -> Hits:
    return Hits(hits.depth[use], hits.normal[use], None, hits.border[use])


def solve(views: Sequence[View], columns: Columns, rounds: int = _ROUNDS) -> Solution:
    """
    Estimate poses and shared coefficients together.

    Parameters
    ----------
    views : sequence of View
        Views with approximately correct poses.
    columns : Columns
        Which errors are shared.
    rounds : int
        Maximum number of Gauss-Newton steps.

    Returns
    -------
    Solution

    """
    values = np.zeros(len(columns.names))
    current = list(views)
    for _ in range(rounds):
        equations = [linearise(view, columns, values)[0] for view in current]
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


def reduced(equations: Sequence[Linear], columns: Columns) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal equations of the coefficients, without poses (Schur complement)."""
    S, s = np.diag(columns.precision), np.zeros(len(columns.names))
    for one in equations:
        part, side = _share(one)
        S, s = S + part, s + side
    return S, s


def _share(one: Linear) -> tuple[np.ndarray, np.ndarray]:
    free = one.free(one.A)
    return (free * one.weight[:, None]).T @ one.A, free.T @ (one.weight * one.y)


def _finish(views: list[View], columns: Columns, values: np.ndarray) -> Solution:
    equations = [linearise(view, columns, values)[0] for view in views]
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
    count = len(apart)
    jackknife = np.sqrt((count - 1) / count * ((apart - apart.mean(axis=0)) ** 2).sum(axis=0))
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
        drags.append(_PRIOR * H_inverse @ (one.J.T @ (one.weight * one.bias)))
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
        apart,
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

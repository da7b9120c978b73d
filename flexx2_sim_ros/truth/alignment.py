"""Align a depth image to a room: Gauss-Newton on what each ray measures, with a robust loss."""

from dataclasses import dataclass, replace

from flexx2_sim_ros.truth.observation import Observation
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.robust import robust_sigma
from flexx2_sim_ros.truth.rooms import Hits, Room
import numpy as np

# Larger residuals are truncated to this: metres.
TRUNCATION = 0.1
_NOISE = 2.0  # standard deviations of noise that do not count as a misfit
_GRAZING = 0.25  # cosine of the incidence angle: 75 degrees
_CAUCHY = 1.5  # in units of the scale
_LEAST_SCALE = 0.0005  # metres: no mesh is better
_LONGEST_STEP, _WIDEST_STEP = 0.15, 0.15  # metres, radians
_CONVERGED = 2e-6
_TILE = 8  # pixels


@dataclass(frozen=True)
class AlignedPixels:
    """
    The pixels that are aligned.

    Attributes
    ----------
    rays : numpy.ndarray
        (N, 2).
    depth, sigma, length : numpy.ndarray
        (N,) as in `Observation`.
    wraps : tuple of float
    pixel : numpy.ndarray
        (N,) places in the flat image.
    tile : numpy.ndarray
        (N,) number of the 8 x 8 block of the image; errors within a block are not independent.

    """

    rays: np.ndarray
    depth: np.ndarray
    sigma: np.ndarray
    length: np.ndarray
    wraps: tuple[float, ...]
    pixel: np.ndarray
    tile: np.ndarray

    def picked(self, use: np.ndarray) -> 'AlignedPixels':
        """Return the pixels that an (N,) bool array picks."""
        values = {name: value[use] for name, value in vars(self).items() if name != 'wraps'}
        return replace(self, **values)


@dataclass(frozen=True)
class AlignedPose:
    """
    An aligned pose.

    Attributes
    ----------
    pose : Pose
    cost : float
        Mean truncated residual, 0 to 1.

    """

    pose: Pose
    cost: float


def choose(observation: Observation, most: int, seed: int = 0) -> AlignedPixels:
    """Return up to `most` pixels, drawn at random from those on smooth surfaces."""
    good = np.flatnonzero(observation.smooth)
    if len(good) > most:
        good = np.sort(np.random.default_rng(seed).choice(good, most, replace=False))
    width = observation.depth.shape[1]
    tiles = (good // width // _TILE) * (width // _TILE + 1) + good % width // _TILE
    return AlignedPixels(
        observation.rays.reshape(-1, 2)[good],
        observation.depth.ravel()[good],
        observation.sigma.ravel()[good],
        observation.length.ravel()[good],
        observation.wraps,
        good,
        np.unique(tiles, return_inverse=True)[1],
    )


def unwrapped(residual: np.ndarray, length: np.ndarray, wraps: tuple[float, ...]) -> np.ndarray:
    """
    Return residuals (metres along the optical axis) without the whole wraps that explain them.

    A wrap is subtracted where it explains nine tenths of the residual; `length` is that of a ray
    per metre of depth.

    """
    out = residual.copy()
    for period in wraps:
        step = period / length
        left = residual - step * np.rint(residual / step)
        with np.errstate(invalid='ignore'):
            better = (np.abs(left) < 0.1 * np.abs(residual)) & (np.abs(left) < np.abs(out))
        out[better] = left[better]
    return out


def jacobian(hits: Hits, rays: np.ndarray) -> np.ndarray:
    """Return (N, 6): the change of depth along each ray per motion of the camera."""
    point = np.column_stack([rays, np.ones(len(rays))]) * hits.depth[:, None]
    change = np.concatenate([hits.normal, np.cross(point, hits.normal)], axis=1)
    with np.errstate(invalid='ignore', divide='ignore'):
        return -change / hits.slant(rays)[:, None]


def facing(hits: Hits, target: AlignedPixels) -> np.ndarray:
    """Return (N,) bool: hits that are not at a grazing angle."""
    with np.errstate(invalid='ignore'):
        return -hits.slant(target.rays) > _GRAZING * target.length


def residuals(hits: Hits, target: AlignedPixels) -> np.ndarray:
    """Return (N,) measured minus expected depth, without whole wraps; NaN without a hit."""
    return unwrapped(target.depth - hits.depth, target.length, target.wraps)


def cost(residual: np.ndarray, sigma: np.ndarray, reach: float = TRUNCATION) -> float:
    """Return the mean of truncated residuals, 0 to 1; a ray without a hit counts in full."""
    limit = reach + _NOISE * sigma
    with np.errstate(invalid='ignore'):
        return float(np.fmin(np.abs(residual) / limit, 1).mean()) if len(residual) else 1.0


def robust_weights(residual: np.ndarray, variance: np.ndarray, widest: float) -> np.ndarray:
    """Return (N,) weights of a Cauchy loss, of a scale up to `widest`, metres; 0 for NaN."""
    good = np.isfinite(residual)
    if not good.any():
        return np.zeros(len(residual))
    scale2 = np.clip(_CAUCHY * robust_sigma(residual), _LEAST_SCALE, widest) ** 2 + variance
    return np.where(good, 1 / (scale2 + np.nan_to_num(residual) ** 2), 0.0)


def align(
    room: Room, target: AlignedPixels, start: Pose, steps: int = 20, reach: float = TRUNCATION
) -> AlignedPose:
    """
    Align pixels to a room, in so many steps, from a pose within about 0.2 m and 10 degrees.

    Residuals beyond `reach`, metres, are truncated. A large value converges from farther away, a
    small one is more robust.

    """
    pose, damping = start, 1e-3
    hits = room.cast(pose, target.rays)
    residual = residuals(hits, target)
    best = cost(residual, target.sigma, reach)
    for _ in range(steps):
        use = facing(hits, target) & np.isfinite(residual)
        if use.sum() < 12:
            break
        J = jacobian(hits, target.rays)[use]
        # The error of a mesh is perpendicular to its surface.
        variance = target.sigma[use] ** 2
        weight = robust_weights(residual[use], variance, reach)
        H = (J * weight[:, None]).T @ J
        step = np.linalg.solve(
            H + damping * np.diag(np.diag(H) + 1e-9), J.T @ (weight * residual[use])
        )
        step = clamped(step)
        trial = pose.moved(step)
        hits_there = room.cast(trial, target.rays)
        residual_there = residuals(hits_there, target)
        cost_there = cost(residual_there, target.sigma, reach)
        if cost_there <= best * (1 + 1e-6):
            pose, hits, residual, best = trial, hits_there, residual_there, cost_there
            damping = max(damping / 10, 1e-6)
        else:
            damping *= 10
            if damping > 1e3:
                break
        if np.abs(step).max() < _CONVERGED:
            break
    return AlignedPose(pose, best)


def clamped(step: np.ndarray) -> np.ndarray:
    """Return a (6,) step, limited to the size for which the linearisation holds."""
    long = np.linalg.norm(step[:3]) / _LONGEST_STEP
    wide = np.linalg.norm(step[3:]) / _WIDEST_STEP
    return step / max(long, wide, 1.0)

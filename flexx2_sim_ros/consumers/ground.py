"""Where the ground is below a camera, from the true depth of the scene."""

import math
from typing import NamedTuple

from flexx2_sim_ros.consumers.height_grid import AHEAD, LEFT, mean_heights
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.physics.surface import PAD, tangents
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.sensor import Sensor
import numpy as np

# The ground's normal is at most so far from the image's upward direction, and to its side.
_PITCH, _ROLL = math.radians(70), math.radians(20)
_LEAST = 0.03  # least fraction of the image that the ground covers
_NEAR = 0.02  # metres from the plane
_LOWEST = 0.05  # of a camera above the ground, metres
_SAMPLE = 3000  # points that RANSAC sees
_FAR = 2.5  # metres ahead that a height grid is looked for


class CameraAboveGround(NamedTuple):
    """
    A camera above the ground.

    ``rotation`` is (3, 3) from the optical frame to the ground frame, ``position`` (3,) that of
    the camera in the ground frame, metres.
    """

    rotation: np.ndarray
    position: np.ndarray


def fit_ground(points: np.ndarray) -> tuple[float, float, float] | None:
    """
    Fit a plane z = a x + b y + c to points, (N, 3) metres, by RANSAC.

    Returned are a, b and c; None with too few points.
    """
    some = points[:: max(len(points) // _SAMPLE, 1)]
    if len(some) < 10:
        return None
    # Imported here: it takes a second, which other commands and workers need not wait for.
    from sklearn.linear_model import RANSACRegressor

    search = RANSACRegressor(residual_threshold=_NEAR, random_state=0, max_trials=50)
    try:
        search.fit(some[:, :2], some[:, 2])
    except ValueError:  # no consensus
        return None
    a, b = search.estimator_.coef_
    return float(a), float(b), float(search.estimator_.intercept_)


def mounted(height: float, pitch: float) -> CameraAboveGround:
    """Return where a camera is at a height, metres, that looks down by an angle, degrees."""
    down = math.radians(pitch)
    ahead = np.array([0.0, -math.sin(down), math.cos(down)])
    return _standing(np.array([0.0, -math.cos(down), -math.sin(down)]), ahead, height)


def find_ground(clean: np.ndarray, lens: Intrinsics, sensor: Sensor) -> CameraAboveGround | None:
    """
    Find the ground: the largest plane that faces up; None if the image shows none.

    ``clean`` is (H, W) float32 true depth, metres, NaN where unknown. ``sensor`` has the
    thresholds of depth jumps.
    """
    inverse, across, down = tangents(np.nan_to_num(clean), sensor)
    here = inverse[PAD:-PAD, PAD:-PAD]
    v, u = np.mgrid[: lens.height, : lens.width]
    u, v = u - lens.cx, v - lens.cy
    # The plane n . X = 1; n points away from the camera.
    n = np.stack([lens.fx * across, lens.fy * down, here - u * across - v * down], axis=-1)
    length = np.linalg.norm(n, axis=-1)
    x, y = pixel_rays(lens)
    facing = (
        (here > 0)
        & np.isfinite(x)
        & (n[..., 1] > math.cos(_PITCH) * length)
        & (np.abs(n[..., 0]) < math.sin(_ROLL) * length)
    )
    if facing.sum() < _LEAST * facing.size:
        return None
    points = (np.stack([x, np.ones_like(x), y], axis=-1) * clean[..., None])[facing]
    plane = fit_ground(points)  # y = a x + b z + c in the optical frame
    if plane is None:
        return None
    a, b, c = plane
    near = np.abs(points[:, 2] - points[:, :2] @ (a, b) - c) < _NEAR
    up = np.array([a, -1.0, b]) / math.sqrt(a * a + 1 + b * b)
    height = c * -up[1]
    upright = -up[1] > math.cos(_PITCH) and abs(up[0]) < math.sin(_ROLL)
    if near.sum() < _LEAST * facing.size or not upright or height < _LOWEST:
        return None
    return _standing(up, np.array([0.0, 0.0, 1.0]), height)


def _standing(up: np.ndarray, along: np.ndarray, height: float) -> CameraAboveGround:
    ahead = along - up * (along @ up)
    ahead = ahead / np.linalg.norm(ahead)
    rotation = np.stack([ahead, np.cross(up, ahead), up])
    return CameraAboveGround(rotation, np.array([0.0, 0.0, height]))


def best_centre(points: np.ndarray) -> float | None:
    """
    Return how far ahead the window of the height grid shows most ground, metres.

    ``points`` are (N, 3) of the true depth, ground frame, metres. None where less than half of any
    window is seen.
    """
    pitch = float(AHEAD[1] - AHEAD[0])
    places = np.round(np.arange(0.0, _FAR, pitch), 3)
    seen = np.isfinite(mean_heights(points, places, LEFT)).sum(axis=1)
    windows = np.convolve(seen, np.ones(len(AHEAD)), 'valid')
    best = int(windows.argmax())
    if windows[best] < 0.5 * len(AHEAD) * len(LEFT):
        return None
    return float(places[best] - AHEAD[0])

"""The ground plane and the nearest obstacle, by RANSAC."""

from typing import ClassVar, NamedTuple

from flexx2_sim_ros.consumers.consumer import CameraView
from flexx2_sim_ros.consumers.ground import fit_ground
import numpy as np

# A robot 0.6 m wide and 0.6 m high; what is lower than a step is no obstacle, metres.
_HALF_WIDTH, _LOWEST, _HIGHEST = 0.3, 0.06, 0.6
_LEAST = 0.002  # fraction of the image that an obstacle covers at least
_NEAREST = 0.1  # quantile of the distances of an obstacle's points
_FRAMES = 3
_THICK = 0.1  # metres that the nearest obstacle is deep
_STEEPEST = 1.0  # slope of the ground
_FAR = 3.0  # metres ahead that obstacles are looked for


class Ahead(NamedTuple):
    """
    What is ahead, (T,), one number for each frame.

    Attributes
    ----------
    tilt : numpy.ndarray
        Angle between the plane and the vertical axis, degrees; NaN without a plane.
    height : numpy.ndarray
        Of the plane below the camera's foot point, metres; NaN without a plane.
    distance : numpy.ndarray
        Of the nearest obstacle from the camera, along the ground, metres; infinite without.

    """

    tilt: np.ndarray
    height: np.ndarray
    distance: np.ndarray


class NearestObstacle:
    """The ground plane by RANSAC (scikit-learn), and the nearest obstacle above it."""

    name = 'nearest_obstacle'
    measures: ClassVar[dict[str, str]] = {
        'ground_tilt_error': 'degrees',
        'ground_height_error': 'mm',
        'distance_error': 'mm',
        'wrong_presence': '%',
    }

    def look(self, view: CameraView) -> Ahead:
        """Find the ground and the nearest obstacle in the last three frames."""
        frames = range(max(len(view.depth) - _FRAMES, 0), len(view.depth))
        return Ahead(*np.array([_ahead(view, t) for t in frames]).T)

    def errors(self, seen: Ahead, true: Ahead) -> dict[str, float]:
        """Return the errors; ``wrong_presence``: an obstacle is seen where none is, or missed."""
        near, real = np.isfinite(seen.distance), np.isfinite(true.distance)
        out = {'wrong_presence': 100 * float((near != real).mean())}
        if (near & real).any():
            error = np.abs(seen.distance - true.distance)[near & real]
            out['distance_error'] = 1000 * float(error.mean())
        good = np.isfinite(seen.tilt) & np.isfinite(true.tilt)
        if good.any():
            out['ground_tilt_error'] = float(np.abs(seen.tilt - true.tilt)[good].mean())
            out['ground_height_error'] = 1000 * float(
                np.abs(seen.height - true.height)[good].mean()
            )
        return out


def _ahead(view: CameraView, frame: int) -> tuple[float, float, float]:
    points = view.points(frame)
    low = points[np.abs(points[:, 2]) < 2 * _LOWEST]
    plane = fit_ground(low)
    if plane is None or np.hypot(*plane[:2]) > _STEEPEST:
        return np.nan, np.nan, np.inf
    a, b, c = plane
    above = points[:, 2] - points[:, :2] @ (a, b) - c
    way = (np.abs(points[:, 1]) < _HALF_WIDTH) & (above > _LOWEST) & (above < _HIGHEST)
    way &= points[:, 0] < _FAR
    distance = np.sort(points[way, 0])
    count = max(round(_LEAST * view.depth[frame].size), 1)
    nearest = np.inf
    if len(distance) >= count:
        # The first place where so many points lie within the thickness of an obstacle.
        near = np.flatnonzero(
            distance[count - 1 :] - distance[: len(distance) - count + 1] < _THICK
        )
        if len(near):
            start = near[0]
            nearest = float(np.quantile(distance[start : start + count], _NEAREST))
    return float(np.degrees(np.arctan(np.hypot(a, b)))), c, nearest

"""An elevation map with a Kalman filter for each cell."""

from typing import ClassVar, NamedTuple

from flexx2_sim_ros.consumers.consumer import CameraView
from flexx2_sim_ros.consumers.height_grid import edge_error, height_errors, STEP
from flexx2_sim_ros.physics.compiled import loop
import numpy as np

# Corner and size of the map: metres ahead and to the left, and the size of a cell.
_FIRST, _CELLS, _PITCH = (0.0, -1.0), (50, 50), 0.04
_HIGHEST = 0.6  # metres above the ground: what is higher is above the robot
# Fankhauser et al., Probabilistic Terrain Mapping for Mobile Robots with Uncertain Localization
# (RA-L 2018); the numbers are defaults of ANYbotics/elevation_mapping. Least variance of a
# height, Mahalanobis distance beyond which a point is not fused, and what such a point adds to
# the variance of its cell.
_LEAST_VARIANCE, _GATE, _MULTI_HEIGHT = 0.003**2, 2.5, 0.003**2


@loop()
def fuse(points, variances, first, pitch, heights, spread, low, high):
    """
    Fuse points, (N, 3) float64 metres, into a map, one after the other.

    ``variances`` are (N,) float64 of their heights, square metres; ``first`` is the corner of the
    map and ``pitch`` the size of a cell, metres. The rest are (X, Y) float64, changed in place:
    height of each cell, NaN without data, and its variance, and lowest and highest point.
    """
    for k in range(len(points)):
        i = int(np.floor((points[k, 0] - first[0]) / pitch))
        j = int(np.floor((points[k, 1] - first[1]) / pitch))
        if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
            continue
        z, variance = points[k, 2], variances[k]
        low[i, j], high[i, j] = min(low[i, j], z), max(high[i, j], z)
        before = spread[i, j]
        if np.isnan(heights[i, j]):
            heights[i, j], spread[i, j] = z, variance
        elif (z - heights[i, j]) ** 2 < _GATE**2 * before:
            heights[i, j] = (before * z + variance * heights[i, j]) / (before + variance)
            spread[i, j] = max(before * variance / (before + variance), _LEAST_VARIANCE)
        else:
            spread[i, j] = before + _MULTI_HEIGHT


class Elevation(NamedTuple):
    """Heights, (X, Y) metres, NaN without data; ``upright``: points over a step apart, bool."""

    heights: np.ndarray
    upright: np.ndarray


class ElevationMap:
    """An elevation map: 2 m x 2 m ahead of the camera, a Kalman filter for each cell of 4 cm."""

    name = 'elevation_map'
    measures: ClassVar[dict[str, str]] = {
        'height_error': 'mm',
        'cells_without_data': '%',
        'invented_steps': '',
        'missed_steps': '',
        'edge_error': 'mm',
    }

    def look(self, view: CameraView) -> Elevation:
        """Return the map after all frames."""
        heights, spread = np.full(_CELLS, np.nan), np.zeros(_CELLS)
        low, high = np.full(_CELLS, np.inf), np.full(_CELLS, -np.inf)
        upward = view.directions()[..., 2]
        for t, depth in enumerate(view.depth):
            good = view.valid(t)
            points = view.points(t)
            variances = (view.sigma(depth[good]) * upward[good]) ** 2
            variances = np.maximum(variances.astype(float), _LEAST_VARIANCE)
            below = points[:, 2] < _HIGHEST
            fuse(points[below], variances[below], _FIRST, _PITCH, heights, spread, low, high)
        return Elevation(heights, high - low > STEP)

    def errors(self, seen: Elevation, true: Elevation) -> dict[str, float]:
        """Return the errors of heights, steps and their edges."""
        edge = edge_error(seen.heights, true.heights, _PITCH)
        level = np.where(true.upright, np.nan, true.heights)
        return height_errors(seen.heights, level) | ({} if edge is None else {'edge_error': edge})

    def picture(self, seen: Elevation, true: Elevation) -> np.ndarray:
        """Return the error of each height for the report, metres."""
        return np.where(true.upright, np.nan, seen.heights - true.heights)

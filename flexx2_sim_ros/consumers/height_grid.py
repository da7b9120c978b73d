"""The height grid that the paper's controller reads."""

from typing import ClassVar

from flexx2_sim_ros.consumers.consumer import CameraView
from flexx2_sim_ros.consumers.steps import height_errors
from flexx2_sim_ros.formulas import grid_cells, on_images
import numpy as np

# Of the paper's group's locomotion policies: metres ahead and to the left of the trunk.
AHEAD = np.round(np.arange(-0.5, 0.51, 0.1), 3)
LEFT = np.round(np.arange(-0.3, 0.31, 0.1), 3)
# Points no further from a grid point than this, ahead and to the left, count, metres.
REACH = 0.025
LEAST = 8  # fewer points are none

_nearest_cell = on_images(grid_cells.nearest_cell)
_from_cell = on_images(grid_cells.from_cell)


def mean_heights(points: np.ndarray, ahead: np.ndarray, left: np.ndarray) -> np.ndarray:
    """
    Return the mean height of the points near each point of a grid.

    Parameters
    ----------
    points : numpy.ndarray
        (N, 3) metres.
    ahead, left : numpy.ndarray
        (X,) and (Y,) evenly spaced coordinates of the grid, metres.

    Returns
    -------
    numpy.ndarray
        (X, Y) metres, NaN with fewer than `LEAST` points.

    """
    shape = len(ahead), len(left)
    cells, near = [], np.ones(len(points), bool)
    for x, axis in ((points[:, 0], ahead), (points[:, 1], left)):
        pitch = axis[1] - axis[0]
        cell = _nearest_cell(x, axis[0], pitch)
        near &= (cell >= 0) & (cell < len(axis)) & (_from_cell(x, axis[0], pitch, cell) <= REACH)
        cells.append(cell)
    place = (cells[0][near] * shape[1] + cells[1][near]).astype(int)
    count = np.bincount(place, minlength=shape[0] * shape[1])
    total = np.bincount(place, points[near, 2], minlength=shape[0] * shape[1])
    heights = np.where(count >= LEAST, total / np.maximum(count, 1), np.nan)
    return heights.reshape(shape)


class HeightGrid:
    """The height grid of the paper's controller: 11 x 7 points around the robot."""

    name = 'height_grid'
    measures: ClassVar[dict[str, str]] = {
        'height_error': 'mm',
        'cells_without_data': '%',
        'invented_steps': '',
        'missed_steps': '',
    }

    def look(self, view: CameraView) -> np.ndarray | None:
        """Return (11, 7) heights; None where the view does not show the ground around a robot."""
        if view.centre is None:
            return None
        points = np.concatenate([view.points(t) for t in range(len(view.depth))])
        return mean_heights(points, AHEAD + view.centre, LEFT)

    def errors(self, seen: np.ndarray | None, true: np.ndarray | None) -> dict[str, float]:
        """Return the errors of heights and steps."""
        return {} if seen is None or true is None else height_errors(seen, true)

    def picture(self, seen: np.ndarray | None, true: np.ndarray | None) -> np.ndarray | None:
        """Return the error of each height for the report, metres."""
        return None if seen is None or true is None else seen - true

"""The height grid that the paper's controller reads, and the steps of the ground in it."""

from typing import ClassVar

from flexx2_sim_ros.consumers.consumer import CameraView
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import nearest, size
import numpy as np

# A step is a height difference of neighbouring cells that a robot must lift its feet for, metres.
STEP = 0.04
# Below this fraction of a step there is none.
_NONE = 0.5


def height_errors(seen: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """
    Compare heights on a grid, (X, Y) metres, NaN without data, with the true ones.

    ``height_error``: mean absolute difference, mm. ``cells_without_data``: fraction of the true
    cells, %. ``invented_steps``: neighbours that differ by more than a step where the true ones do
    not. ``missed_steps``: the reverse. Empty if there are no true heights.
    """
    shown = np.isfinite(true)
    if not shown.any():
        return {}
    both = shown & np.isfinite(seen)
    out = {'cells_without_data': 100 * float(1 - both.sum() / shown.sum())}
    if both.any():
        out['height_error'] = 1000 * float(np.abs(seen - true)[both].mean())
    invented = missed = 0
    for axis in (0, 1):
        found, real = (np.abs(np.diff(one, axis=axis)) for one in (seen, true))
        invented += int(((found > STEP) & (real < _NONE * STEP)).sum())
        missed += int(((real > STEP) & (found < _NONE * STEP)).sum())
    return {**out, 'invented_steps': float(invented), 'missed_steps': float(missed)}


def edge_error(seen: np.ndarray, true: np.ndarray, pitch: float, reach: int = 3) -> float | None:
    """
    Return how far the edges of steps are from the true edges, along the first axis.

    It is the mean absolute distance, mm; None without a true step that is found again. Heights are
    (X, Y) metres, NaN without data, in cells of ``pitch`` metres. Edges are looked for ``reach``
    cells before and behind the true edge.
    """
    distances = []
    for i, j in np.argwhere(np.abs(np.diff(true, axis=0)) > STEP):
        low, high = max(i - reach, 0), min(i + reach + 2, len(true))
        middle = (true[i, j] + true[i + 1, j]) / 2
        edges = [_crossings(one[low:high, j] - middle) + low for one in (true, seen)]
        if len(edges[1]):
            own = edges[0][np.abs(edges[0] - i - 0.5).argmin()]
            distances.append(float(np.abs(edges[1] - own).min()))
    return 1000 * pitch * float(np.mean(distances)) if distances else None


def _crossings(profile: np.ndarray) -> np.ndarray:
    # Where a profile changes its sign, in cells, linear between cells.
    a, b = profile[:-1], profile[1:]
    at = np.flatnonzero((a * b < 0) | ((a == 0) & (b != 0)))
    return at + a[at] / (a[at] - b[at])


# Of the paper's group's locomotion policies: metres ahead and to the left of the trunk.
AHEAD = np.round(np.arange(-0.5, 0.51, 0.1), 3)
LEFT = np.round(np.arange(-0.3, 0.31, 0.1), 3)
# Points no further from a grid point than this, ahead and to the left, count, metres.
REACH = 0.025
LEAST = 8  # fewer points are none


def nearest_cell(x: float, first: float, pitch: float) -> float:
    """Return the index of the grid point nearest to a place; ``first`` has index 0. All metres."""
    return nearest((x - first) / pitch)


def from_cell(x: float, first: float, pitch: float, cell: float) -> float:
    """Return the distance of a place from a grid point, metres."""
    return size(x - first - cell * pitch)


_nearest_cell = on_images(nearest_cell)
_from_cell = on_images(from_cell)


def mean_heights(points: np.ndarray, ahead: np.ndarray, left: np.ndarray) -> np.ndarray:
    """
    Return the mean height of points, (N, 3) metres, near each point of a grid.

    ``ahead`` (X,) and ``left`` (Y,) are evenly spaced coordinates of the grid, metres. Heights are
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

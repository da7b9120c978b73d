"""Which cell of a grid a place lies in, along one axis."""

from flexx2_sim_ros.formulas.scalars import nearest, size


def nearest_cell(x: float, first: float, pitch: float) -> float:
    """
    Return the index of the grid point nearest to a place, as a whole number.

    All are in metres: ``first`` is the grid point with index 0, ``pitch`` the distance of grid
    points.
    """
    return nearest((x - first) / pitch)


def from_cell(x: float, first: float, pitch: float, cell: float) -> float:
    """Return the distance of a place from a grid point, metres."""
    return size(x - first - cell * pitch)

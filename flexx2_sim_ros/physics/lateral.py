"""
Lateral noise: edges that jitter as a whole.

An edge is moved by a Gaussian number of whole pixels, along the row where it runs more upright,
along the column where it runs more level. Everything within reach of the edge in that row (or
column) moves together; rows, columns and frames are independent. A pixel between the edge's old
and new place takes the other surface's value; every other pixel keeps its own, so slanted
surfaces get no extra axial noise.
"""

import math

from flexx2_sim_ros.formulas import edges
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.philox import edge_draw, STREAM_COLUMN_EDGES, STREAM_ROW_EDGES
from numba import njit
import numpy as np

_NEVER = np.uint8(255)
_FURTHEST = 127  # pixels, which the batch keeps in a byte
WINDOW = 4  # An edge's direction is judged over 9 x 9 pixels.

_is_upright = compiled(edges.is_upright)
_is_apart = compiled(edges.is_apart)
_passed_pixel = compiled(edges.passed_pixel)
_pixels_moved = compiled(edges.pixels_moved)
_source_of = compiled(edges.source_of)


def pixel_sigma(sigma_x: float) -> float:
    """
    Return the standard deviation to draw before rounding to whole pixels.

    Rounding adds 1/12 px^2 to the variance; it is taken off beforehand.
    """
    return math.sqrt(max(sigma_x**2 - 1.0 / 12.0, 0.0))


def edge_limit(sigma_x: float, laplace: float = 0.0) -> int:
    """
    Return the largest displacement of an edge, pixels.

    Five standard deviations: 1 edge in 2 million would have gone further. With Laplacian edges
    (``laplace`` is their fraction) up to ten.
    """
    return min(math.ceil((5 + 5 * laplace) * sigma_x), _FURTHEST)


@loop()
def upright_edges(row_jumps, column_jumps, rows, columns):
    """
    Sort jumps into edges that move along the row and edges that move along the column.

    ``rows`` and ``columns`` (uint8, like the inputs) receive the row jumps of edges that run
    nearer to vertical (or exactly diagonal) and the column jumps of the others. Returns how many
    there are.
    """
    height, width = row_jumps.shape
    count = 0
    for y in range(height):
        for x in range(width):
            rows[y, x] = 0
            columns[y, x] = 0
            if row_jumps[y, x] == 0 and column_jumps[y, x] == 0:
                continue
            across = 0
            down = 0
            for yy in range(max(y - WINDOW, 0), min(y + WINDOW + 1, height)):
                for xx in range(max(x - WINDOW, 0), min(x + WINDOW + 1, width)):
                    across += row_jumps[yy, xx]
                    down += column_jumps[yy, xx]
            if _is_upright(across, down):
                rows[y, x] = row_jumps[y, x]
                count += row_jumps[y, x]
            else:
                columns[y, x] = column_jumps[y, x]
                count += column_jumps[y, x]
    return count


@njit(inline='always')
def _displace(source, distance, along, shift, last, first, pitch):
    # One edge, between positions `along` and `along + 1` of a line of `last + 1` pixels. Pixels
    # are addressed as first + position * pitch. The nearest displaced edge wins.
    for step in range(1, abs(shift) + 1):
        position = _passed_pixel(along, step, shift)
        if position < 0 or position > last:
            break
        pixel = first + position * pitch
        if step < distance[pixel]:
            distance[pixel] = step
            source[pixel] = first + _source_of(position, shift, last) * pitch


@loop()
def displaced_sources(
    rows, columns, neighbourhood, sigma, limit, key, stamp_low, stamp_high, laplace, source
):
    """
    Say where each pixel's value comes from once the edges have moved.

    Parameters
    ----------
    rows, columns : numpy.ndarray
        (H, W) uint8 from `upright_edges`.
    neighbourhood : int
        Edges of one line no further apart than this move together.
    sigma : float
        Standard deviation before rounding, pixels.
    limit : int
        Largest displacement, pixels.
    key, stamp_low, stamp_high
        The counter-based generator's key and stamp.
    laplace : float
        Fraction of edges that move by a Laplacian of the same standard deviation.
    source : numpy.ndarray
        (H * W,) int32, receives flat pixel indices: the pixel's own, or another surface's.

    """
    height, width = rows.shape
    distance = np.full(height * width, _NEVER, np.uint8)
    for pixel in range(height * width):
        source[pixel] = pixel
    for y in range(height):
        last_edge = -1 - neighbourhood
        shift = 0
        for x in range(width - 1):
            if rows[y, x]:
                if _is_apart(x, last_edge, neighbourhood):
                    draw = edge_draw(
                        key, y * width + x, STREAM_ROW_EDGES, stamp_low, stamp_high, laplace
                    )
                    shift = _pixels_moved(draw, sigma, limit)
                last_edge = x
                _displace(source, distance, x, shift, width - 1, y * width, 1)
    for x in range(width):
        last_edge = -1 - neighbourhood
        shift = 0
        for y in range(height - 1):
            if columns[y, x]:
                if _is_apart(y, last_edge, neighbourhood):
                    draw = edge_draw(
                        key, y * width + x, STREAM_COLUMN_EDGES, stamp_low, stamp_high, laplace
                    )
                    shift = _pixels_moved(draw, sigma, limit)
                last_edge = y
                _displace(source, distance, y, shift, height - 1, x, width)

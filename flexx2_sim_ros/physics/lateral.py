"""
Lateral noise: edges that jitter as a whole.

An edge is moved by a Gaussian number of whole pixels, along the row where it runs more upright,
along the column where it runs more level. Everything within reach of the edge in that row (or
column) moves together; rows, columns and frames are independent. A pixel between the edge's old
and new place takes the other surface's value; every other pixel keeps its own, so slanted
surfaces get no extra axial noise.
"""

import math

from flexx2_sim_ros.formulas import pixels as pixel_formulas
from flexx2_sim_ros.physics.compiled import compiled, inlined, loop
from flexx2_sim_ros.physics.philox import edge_draw, STREAM_COLUMN_EDGES, STREAM_ROW_EDGES
import numpy as np

_NEVER = np.uint8(255)
_FURTHEST = 127  # pixels, which the batch keeps in a byte
WINDOW = 4  # An edge's direction is judged over 9 x 9 pixels.

_is_upright = compiled(pixel_formulas.is_upright)
_is_apart = compiled(pixel_formulas.is_apart)
_passed_pixel = compiled(pixel_formulas.passed_pixel)
_pixels_moved = compiled(pixel_formulas.pixels_moved)
_source_of = compiled(pixel_formulas.source_of)


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
def upright_edges(row_jumps, column_jumps):
    """
    Sort jumps into edges that move along the row and edges that move along the column.

    Both jumps are (H, W) uint8, as in `Surface`. Returned are int32 flat pixel indices, rising:
    the row jumps of edges that run nearer to vertical (or exactly diagonal), and the column jumps
    of the others.
    """
    height, width = row_jumps.shape
    row_edges = np.empty(row_jumps.size, np.int32)
    column_edges = np.empty(row_jumps.size, np.int32)
    row_count = 0
    column_count = 0
    # Jumps in the window's rows, by column; beyond the image there are none.
    across = np.zeros(width + 2 * WINDOW, np.uint8)
    down = np.zeros(width + 2 * WINDOW, np.uint8)
    entering = 0
    for y in range(height):
        while entering <= y + WINDOW:
            if entering < height:
                for i in range(width):
                    across[i + WINDOW] += row_jumps[entering, i]
                    down[i + WINDOW] += column_jumps[entering, i]
            leaving = entering - 2 * WINDOW - 1
            if leaving >= 0:
                for i in range(width):
                    across[i + WINDOW] -= row_jumps[leaving, i]
                    down[i + WINDOW] -= column_jumps[leaving, i]
            entering += 1
        for x in range(width):
            if not row_jumps[y, x] | column_jumps[y, x]:
                continue
            jumps_across = np.int32(0)
            jumps_down = np.int32(0)
            for i in range(2 * WINDOW + 1):
                jumps_across += across[np.uint32(x + i)]
                jumps_down += down[np.uint32(x + i)]
            if _is_upright(jumps_across, jumps_down):
                row_edges[row_count] = y * width + x
                row_count += row_jumps[y, x]
            else:
                column_edges[column_count] = y * width + x
                column_count += column_jumps[y, x]
    return row_edges[:row_count].copy(), column_edges[:column_count].copy()


@inlined
def _displace(arrays, count, along, shift, last, first, pitch):
    # One edge, between positions `along` and `along + 1` of a line of `last + 1` pixels. Pixels
    # are addressed as first + position * pitch. The nearest displaced edge wins. `count` pixels
    # have moved before; returns how many have moved after.
    distance, moved, source = arrays
    for step in range(1, abs(shift) + 1):
        position = _passed_pixel(along, step, shift)
        if position < 0 or position > last:
            break
        pixel = first + position * pitch
        if step < distance[pixel]:
            if distance[pixel] == _NEVER:
                moved[count] = pixel
                count += 1
            distance[pixel] = step
            source[pixel] = first + _source_of(position, shift, last) * pitch
    return count


@loop()
def displaced_pixels(
    row_edges,
    column_edges,
    height,
    width,
    neighbourhood,
    sigma,
    limit,
    key,
    stamp_low,
    stamp_high,
    laplace,
):
    """
    Say which pixels show another one's surface once the edges have moved.

    Edges are int32 flat pixel indices from `upright_edges`. Those of one line no further apart
    than ``neighbourhood`` move together, with the standard deviation ``sigma`` before rounding and
    by at most ``limit``, in pixels. ``key``, ``stamp_low`` and ``stamp_high`` are those of the
    counter-based generator. ``laplace`` is the fraction of edges that move by a Laplacian of the
    same standard deviation. Returned are int32 flat pixel indices: pixels, each once, and the
    pixel whose value each one takes.
    """
    distance = np.full(height * width, _NEVER, np.uint8)
    moved = np.empty(height * width, np.int32)
    source = np.empty(height * width, np.int32)
    arrays = distance, moved, source
    count = 0
    last_y, last_x, shift = -1, 0, 0
    for edge in row_edges:
        y, x = edge // width, edge % width
        if y != last_y or _is_apart(x, last_x, neighbourhood):
            draw = edge_draw(key, edge, STREAM_ROW_EDGES, stamp_low, stamp_high, laplace)
            shift = _pixels_moved(draw, sigma, limit)
        last_y, last_x = y, x
        count = _displace(arrays, count, x, shift, width - 1, y * width, 1)
    # The same for each column.
    last_ys = np.full(width, -1 - neighbourhood, np.int32)
    shifts = np.zeros(width, np.int32)
    for edge in column_edges:
        y, x = edge // width, edge % width
        if _is_apart(y, last_ys[x], neighbourhood):
            draw = edge_draw(key, edge, STREAM_COLUMN_EDGES, stamp_low, stamp_high, laplace)
            shifts[x] = _pixels_moved(draw, sigma, limit)
        last_ys[x] = y
        count = _displace(arrays, count, y, shifts[x], height - 1, x, width)
    moved = moved[:count].copy()
    return moved, source[moved]

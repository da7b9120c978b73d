"""Patterns of pixels, compiled: lattices of depth, fixed-pattern noise, sums over groups."""

from flexx2_sim_ros.gap.calibration.features import FEATURES, MEASURES
from flexx2_sim_ros.gap.features.row_sums import CLIP, held
from flexx2_sim_ros.physics.compiled import loop
from numba import njit
import numpy as np

# Compiled code takes constants from its module.
LATTICE_BIN, LATTICE_RANGE = FEATURES.lattice_bin, FEATURES.lattice_range
# Of a group: pixels, valid ones, sum of errors, of squares, gross errors high and low; pairs with
# the frame before and of neighbours (each: count, sums of both, of their squares, of their
# products); errors that are no jump to another surface: count, sum in metres.
GROUP_FRAMES, GROUP_NEIGHBOURS, GROUP_METRES, GROUP_WIDTH = 6, 12, 18, 20
_JUMP = np.float32(FEATURES.jump)
_HALF, _NORMAL = MEASURES.half, MEASURES.normal
_PER_METRE = np.float32(1000 / MEASURES.bin_mm)
_SIGMAS, _PER_SIGMA = np.float32(FEATURES.gross), np.float32(_NORMAL / (2 * FEATURES.gross))


@loop()
def count_depths(depth, inside, ray, histogram):
    """Count how often which depth occurs on surfaces, and which distance along the ray."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z = depth[y, x]
            if inside[y, x] and 0 < z < LATTICE_RANGE:
                i = int(z / np.float32(LATTICE_BIN) + np.float32(0.5))
                j = int(z * ray[y, x] / np.float32(LATTICE_BIN) + np.float32(0.5))
                if i < histogram.shape[1]:
                    histogram[0, i] += 1
                if j < histogram.shape[1]:
                    histogram[1, j] += 1


@loop(error_model='numpy')
def count_errors(depth, clean, sigma, surface, regions, tiles, at_edges, counts, normal, edges):
    """
    Count the errors of a frame.

    * `depth`, `clean`, `sigma`: (H, W) float32 metres, NaN where invalid or where nothing is seen.
    * `surface`: (H, W) bool, pixels away from jumps and sharp bends.
    * `regions`, `tiles`: (H, W) int64, the row of ``counts`` and of ``normal`` for each pixel.
    * `at_edges`: whether pixels that are not on a surface are counted there as well.
    * `counts`: (R, 2 half + 1) int64, added to: errors in bins of `MEASURES.bin_mm`.
    * `normal`, `edges`: (N, B) and (B,) int64, added to: errors in sigma_z, clipped; ``edges`` of
      pixels that are not on a surface.
    """
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            error = depth[y, x] - clean[y, x]
            if not np.isfinite(error):
                continue
            e = min(max(error / sigma[y, x], -_SIGMAS), _SIGMAS)
            i = min(int((e + _SIGMAS) * _PER_SIGMA), _NORMAL - 1)
            if not surface[y, x]:
                edges[i] += 1
                if not at_edges:
                    continue
            place = min(max(np.rint(error * _PER_METRE), np.float32(-_HALF)), np.float32(_HALF))
            counts[regions[y, x], int(place) + _HALF] += 1
            normal[tiles[y, x], i] += 1


@loop(error_model='numpy')
def less_around(total, sigma, count, least):
    """Return total / sigma less its mean over 5 x 5 pixels, NaN where 12 or fewer count."""
    height, width = total.shape
    value, good = (np.zeros((height + 4, width + 4)), np.zeros((height + 4, width + 4)))
    out = np.full((height, width), np.nan)
    for y in range(height):
        for x in range(width):
            if count[y, x] >= least:
                value[y + 2, x + 2] = total[y, x] / sigma[y, x]
                good[y + 2, x + 2] = 1.0
    around, number = np.zeros(width + 4), np.zeros(width + 4)
    for y in range(height):
        # Columns of five first, pixel by pixel: numba compiles rows as arrays for 5 s longer.
        for x in range(width + 4):
            v, g = value[:, x], good[:, x]
            around[x] = v[y] + v[y + 1] + v[y + 2] + v[y + 3] + v[y + 4]
            number[x] = g[y] + g[y + 1] + g[y + 2] + g[y + 3] + g[y + 4]
        for x in range(width):
            near = number[x] + number[x + 1] + number[x + 2] + number[x + 3] + number[x + 4]
            if good[y + 2, x + 2] > 0 and near > 12:
                out[y, x] = (
                    value[y + 2, x + 2]
                    - (around[x] + around[x + 1] + around[x + 2] + around[x + 3] + around[x + 4])
                    / near
                )
    return out


@loop(error_model='numpy')
def grain_moments(grain):
    """
    Return what grain, clipped at 3 sigma, says.

    Number of pixels, sum of squares; mean product of pairs in a row, in a column, side by side.
    """
    height, width = grain.shape
    down = np.zeros((3, width))
    number, square, rows, row_pairs, product, products = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for y in range(height):
        n, line, squares, before = 0.0, 0.0, 0.0, np.nan
        for x in range(width):
            g = grain[y, x]
            if g == g:
                g = min(max(g, -3.0), 3.0)
                n += 1
                line += g
                squares += g * g
                down[0, x] += 1
                down[1, x] += g
                down[2, x] += g * g
                if before == before:
                    product += before * g
                    products += 1
            before = g
        number += n
        square += squares
        rows += line * line - squares
        row_pairs += n * n - n
    columns = (down[1] ** 2 - down[2]).sum() / max((down[0] ** 2 - down[0]).sum(), 1.0)
    return number, square, rows / max(row_pairs, 1.0), columns, product / products


@loop(error_model='numpy')
def add_errors(depth, clean, sigma, cells, out):
    """
    Add up errors in sigma by the cell that each pixel belongs to (-1 for none).

    The columns of ``out`` are those of a group, see above.
    """
    count, height, width = depth.shape
    last = np.full((height, width), np.float32(np.nan))
    for t in range(count):
        i = t if clean.shape[0] > 1 else 0
        for y in range(height):
            left, left_cell = np.float32(np.nan), -1
            for x in range(width):
                cell = cells[i, y, x]
                s = sigma[i, y, x]
                metres = depth[t, y, x] - clean[i, y, x]
                wrong = metres / s if s > 0 else np.float32(np.nan)
                e = held(wrong, CLIP)
                if cell >= 0:
                    row = out[cell]
                    row[0] += 1
                    if e == e:
                        row[1] += 1
                        row[2] += e
                        row[3] += e * e
                        row[4] += 1 if wrong > CLIP else 0
                        row[5] += 1 if wrong < -CLIP else 0
                        if abs(metres) < _JUMP or abs(wrong) < CLIP:
                            row[GROUP_METRES] += 1
                            row[GROUP_METRES + 1] += metres
                        if last[y, x] == last[y, x]:
                            _add_pair(e, last[y, x], row, GROUP_FRAMES)
                        if left_cell == cell and left == left:
                            _add_pair(e, left, row, GROUP_NEIGHBOURS)
                left, left_cell = e, cell
                last[y, x] = e


@njit(inline='always')
def _add_pair(one, other, row, start):
    row[start] += 1
    row[start + 1] += one
    row[start + 2] += other
    row[start + 3] += one * one
    row[start + 4] += other * other
    row[start + 5] += one * other

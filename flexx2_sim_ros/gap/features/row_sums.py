"""Sums over the bins, frames, rows and columns of a recording, compiled."""

from typing import NamedTuple

from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.physics.compiled import loop
from flexx2_sim_ros.physics.philox import FAST
from numba import njit
import numpy as np

# Compiled code takes constants from its module.
CLIP, _CLIP2 = np.float32(FEATURES.gross), np.float32(FEATURES.gross_change)
WIDTH = 17
# VALID counts all valid depths, N_ERROR those whose sigma_z says how their errors are distributed.
# The last four do not come from running sums; three of them are of all surfaces only.
(
    VALID,
    ERROR,
    HIGH,
    LOW,
    N2,
    ABS2,
    SQUARE2,
    N1,
    SQUARE1,
    NEIGHBOUR,
    N_NEIGHBOUR,
    N_ERROR,
    INVERSE,
    EXPECT,
    TREND,
    TIME2,
    TIME,
) = range(WIDTH)
_RUNNING = 13


class RowSurfaces(NamedTuple):
    """
    What of a clean image the sums need; see `PixelCovariates`.

    `clean` and `sigma` are (H, W) float32 metres; `inside` (H, W) bool, surfaces away from jumps;
    `first`, (H + 1,) int32, and `runs`, (N, 3) int16, the runs of pixels in one bin, row by row.
    """

    clean: np.ndarray
    sigma: np.ndarray
    inside: np.ndarray
    first: np.ndarray
    runs: np.ndarray


class FrameTimes(NamedTuple):
    """
    Which frames are summed, each (T,).

    `start` is bool, frames that do not follow the one before; `use` bool, frames that are summed;
    `times` float32, -0.5 to 0.5 over the recording.
    """

    start: np.ndarray
    use: np.ndarray
    times: np.ndarray


class FrameSums(NamedTuple):
    """
    Sums of each frame's surfaces, of differences to the frame before unless it says otherwise.

    `rows`, (T, 2, H), and `columns`, (T, 2, W) float32, are sum and number in each row and column;
    `squares`, (T,) float64, the sum of squares; `invalid`, (T, H) float64, the invalid pixels of
    the frame itself.
    """

    rows: np.ndarray
    columns: np.ndarray
    squares: np.ndarray
    invalid: np.ndarray


class PixelSums(NamedTuple):
    """
    Sums over all frames.

    * `bins`: (BINS, WIDTH) float64, columns as numbered above.
    * `mean`: (2, H, W) float32: per pixel the sum of errors (metres), and their number.
    * `sigma`: (H, W) float32 sum of sigma_z.
    * `errors`: (3, H, W) float32 memory: errors in sigma of the last frame and the two before.
    """

    bins: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    errors: np.ndarray


@loop(error_model='numpy', fastmath=FAST)
def gather_rows(depth, surfaces, frames, frame_sums, pixel_sums, passing, step):
    """
    Add all frames of one clean image to the sums.

    Row by row; loops are short so that they become vector code. A row's sums run on from pixel to
    pixel, so that a bin's part is the difference between the ends of each run of pixels in it.
    `depth` is (T, H, W) float32 metres, NaN where invalid. `passing`: the next frame has another
    clean image. Every `step`-th row is summed.
    """
    _, height, width = depth.shape
    zero = np.float32(0)
    used = np.float32(frames.use.sum())
    sums = np.empty((_RUNNING, width), np.float32)
    running = np.zeros((width + 1, _RUNNING), np.float32)
    scratch = np.empty((4, width), np.float32)
    for y in range(0, height, step):
        sums[:] = zero
        _sum_row(depth, surfaces, frames, frame_sums, pixel_sums, passing, y, sums, scratch)
        if used > zero:
            _add_runs(surfaces, pixel_sums.bins, used, y, sums, running)


@njit(inline='always')
def _sum_row(depth, surfaces, frames, frame_sums, pixel_sums, passing, y, sums, scratch):
    # One row of all frames.
    zero, one, nan = np.float32(0), np.float32(1), np.float32(np.nan)
    count, _, width = depth.shape
    mask, inner, d1, d2 = scratch[0], scratch[1], scratch[2], scratch[3]
    c, s = surfaces.clean[y], surfaces.sigma[y]
    trend = pixel_sums.bins[0]  # the first bin is that of all surfaces
    mean, sigmas, times = pixel_sums.mean, pixel_sums.sigma, frames.times
    rows, columns = frame_sums.rows, frame_sums.columns
    for x in range(width):
        mask[x] = one if surfaces.inside[y, x] else zero
    e, e1, e2 = pixel_sums.errors[0, y], pixel_sums.errors[1, y], pixel_sums.errors[2, y]
    for t in range(count):
        z = depth[t, y]
        if frames.start[t]:
            e[:] = nan
            e1[:] = nan
        for x in range(width):
            e2[x] = e1[x]
        for x in range(width):
            e1[x] = e[x]
        for x in range(width):
            e[x] = held((z[x] - c[x]) / s[x], _CLIP2)
        if frames.use[t]:
            n, seen, total = _sum_errors(z, e, mask, sums)
            frame_sums.invalid[t, y] = n
            trend[TREND] += total * times[t]
            trend[TIME2] += seen * times[t] * times[t]
            trend[TIME] += seen * times[t]
            _sum_mean(z, c, s, e, mask, mean[0, y], mean[1, y], sigmas[y])
            n, total, square = _sum_changes(
                e, e1, mask, d1, sums[N1], sums[SQUARE1], columns[t, 0], columns[t, 1]
            )
            rows[t, 0, y] = total
            rows[t, 1, y] = n
            frame_sums.squares[t] += square
            _sum_seconds(e, e2, mask, d2, inner, sums)
        if passing:
            # An edge in the previous frame does not count as noise of this frame's surface.
            for x in range(width):
                e[x] = e[x] if mask[x] > zero else nan


@njit(inline='always')
def _add_runs(surfaces, bins, used, y, sums, running):
    # Add one row's sums to the bins of its runs of pixels.
    zero, s, width = np.float32(0), surfaces.sigma[y], sums.shape[1]
    for x in range(width):
        sums[INVERSE, x] = sums[N_ERROR, x] / s[x] if s[x] > zero else zero
    for x in range(width):
        for k in range(_RUNNING):
            running[x + 1, k] = running[x, k] + sums[k, x]
    for r in range(surfaces.first[y], surfaces.first[y + 1]):
        low, high, i = surfaces.runs[r, 0], surfaces.runs[r, 1], surfaces.runs[r, 2]
        after, before, total = running[high], running[low], bins[i]
        for k in range(_RUNNING):
            total[k] += after[k] - before[k]
        bins[i, EXPECT] += used * np.float32(high - low)


@njit(inline='always')
def held(value, limit):
    """Return a value within -limit..limit, or NaN."""
    value = limit if value > limit else value
    return -limit if value < -limit else value


# These functions are inlined. Otherwise a fresh compilation and a cached one would be optimised
# differently.
@njit(inline='always')
def _sum_errors(z, e, mask, sums):
    zero, one = np.float32(0), np.float32(1)
    valid, error, high, low, number = (
        sums[VALID],
        sums[ERROR],
        sums[HIGH],
        sums[LOW],
        sums[N_ERROR],
    )
    lost, seen, total = zero, zero, zero
    for x in range(e.size):
        valid[x] += one if z[x] == z[x] else zero
        lost += zero if z[x] == z[x] else mask[x]
    for x in range(e.size):
        value = held(e[x], CLIP)
        value = value if value == value else zero
        error[x] += value
        total += value * mask[x]
    for x in range(e.size):
        number[x] += one if e[x] == e[x] else zero
        seen += mask[x] if e[x] == e[x] else zero
    for x in range(e.size):
        high[x] += one if e[x] > CLIP else zero
    for x in range(e.size):
        low[x] += one if e[x] < -CLIP else zero
    return lost, seen, total


@njit(inline='always')
def _sum_mean(z, c, s, e, mask, total, number, sigmas):
    zero = np.float32(0)
    for x in range(e.size):
        hit = mask[x] if abs(e[x]) < CLIP else zero
        number[x] += hit
        sigmas[x] += s[x] if hit > zero else zero
    for x in range(e.size):
        hit = mask[x] if abs(e[x]) < CLIP else zero
        total[x] += z[x] - c[x] if hit > zero else zero


@njit(inline='always')
def _sum_changes(e, before, mask, d, number, square, column, column_number):
    # Changes between successive frames. Returns pairs, sum and sum of squares of the row.
    zero, one = np.float32(0), np.float32(1)
    n, total, squares = zero, zero, zero
    for x in range(e.size):
        d[x] = held(e[x] - before[x], _CLIP2)
    for x in range(e.size):
        number[x] += one if d[x] == d[x] else zero
    for x in range(e.size):
        value = d[x] if d[x] == d[x] else zero
        square[x] += value * value
        squares += value * value * mask[x]
    for x in range(e.size):
        value = d[x] * mask[x] if d[x] == d[x] else zero
        column[x] += value
        total += value
    for x in range(e.size):
        value = mask[x] if d[x] == d[x] else zero
        column_number[x] += value
        n += value
    return n, total, squares


@njit(inline='always')
def _sum_seconds(e, before, mask, d, inner, sums):
    # Changes over two frames: a filter over two frames does not reduce them.
    zero, one, nan = np.float32(0), np.float32(1), np.float32(np.nan)
    number, size, square, product, pairs = (
        sums[N2],
        sums[ABS2],
        sums[SQUARE2],
        sums[NEIGHBOUR][1:],
        sums[N_NEIGHBOUR][1:],
    )
    for x in range(e.size):
        d[x] = held(e[x] - before[x], _CLIP2)
    for x in range(e.size):
        inner[x] = d[x] if mask[x] > zero else nan
    for x in range(e.size):
        number[x] += one if d[x] == d[x] else zero
    for x in range(e.size):
        size[x] += abs(d[x]) if d[x] == d[x] else zero
    for x in range(e.size):
        square[x] += d[x] * d[x] if d[x] == d[x] else zero
    left, right = inner[:-1], inner[1:]
    for x in range(left.size):
        both = left[x] * right[x]
        product[x] += both if both == both else zero
    for x in range(left.size):
        both = left[x] * right[x]
        pairs[x] += one if both == both else zero

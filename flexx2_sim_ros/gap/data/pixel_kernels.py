"""Compiled loops that sort the pixels of a clean frame into bins."""

from flexx2_sim_ros.gap.calibration.data import BINNING
from flexx2_sim_ros.physics.compiled import loop
from flexx2_sim_ros.physics.surface import PAD
from numba import njit
import numpy as np

# Compiled code takes constants from its module.
EDGE_REACH, NEAR = BINNING.edge_reach, BINNING.near_jump
_CREASE_NEAR, _BEND = BINNING.near_crease, np.float32(BINNING.bend)


@loop()
def put_in_bins(values, where, edges, start, out):
    """
    Write the bin of each value: `start` plus the number of edges below it.

    The result is that of `numpy.searchsorted`; NaN is in the last bin. Each search starts at the
    bin of the previous pixel, because neighbours are mostly in the same bin. `values`, `where`
    (bool) and `out` (int16, written where `where` is True) are (H, W); `edges` is (E,) ascending.
    """
    i = 0
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            if where[y, x]:
                value = values[y, x]
                while i > 0 and value <= edges[i - 1]:
                    i -= 1
                while i < edges.size and not value <= edges[i]:
                    i += 1
                out[y, x] = start + i


@loop()
def surfaces_at(clean, where):
    """
    Return how near and how far the surfaces around pixels are, (2, H, W) float32 metres.

    That is the smallest and the largest depth up to `EDGE_REACH` pixels away; NaN where the pixel
    is not in `where`, (H, W) bool. `clean` is (H, W) float32 metres, NaN where there is no
    surface.
    """
    height, width = clean.shape
    out = np.full((2, height, width), np.float32(np.nan))
    for y in range(height):
        for x in range(width):
            if not where[y, x]:
                continue
            near, far = np.float32(np.inf), np.float32(-np.inf)
            for v in range(max(y - EDGE_REACH, 0), min(y + EDGE_REACH + 1, height)):
                for u in range(max(x - EDGE_REACH, 0), min(x + EDGE_REACH + 1, width)):
                    c = clean[v, u]
                    if c == c:
                        near, far = min(near, c), max(far, c)
            out[0, y, x], out[1, y, x] = near, far
    return out


@loop()
def runs_of(bins):
    """
    Return ``runs`` and ``first`` of `covariates.PixelCovariates`, stretches of a row in one bin.

    `bins` is (A, H, W) int16, the bin of each pixel along each axis, -1 for none.
    """
    axes, height, width = bins.shape
    first = np.zeros(height + 1, np.int32)
    out = np.empty((axes * height * width, 3), np.int16)
    count = 0
    for y in range(height):
        for a in range(axes):
            start = 0
            for x in range(1, width + 1):
                if x == width or bins[a, y, x] != bins[a, y, start]:
                    if bins[a, y, start] >= 0:
                        out[count, 0], out[count, 1], out[count, 2] = start, x, bins[a, y, start]
                        count += 1
                    start = x
        first[y + 1] = count
    return out[:count].copy(), first


@loop()
def mark_edges(p, row_jumps, column_jumps, edge, near):
    """
    Mark the pixels at depth jumps.

    * `p`: (H + 2 PAD, W + 2 PAD) float32 inverse depth, 1/m, 0 where there is none.
    * `row_jumps`, `column_jumps`: (H, W) uint8, 1 at a jump to the pixel on the right, to the
      pixel below.
    * `edge`: (H, W) int16, set to the class at jumps: 4 x direction + 2 x side + distance.
      Direction, in which the other surface lies: 0 right, 1 left, 2 below, 3 above. Side: 0 near,
      1 far. Distance: 0 next to the jump, 1 two to three pixels away.
    * `near`: (H, W) bool, set where a jump is too near for a pixel to count as surface.
    """
    height, width = edge.shape
    reach = EDGE_REACH
    for y in range(height):
        for x in range(width):
            if row_jumps[y, x]:
                here, there = p[y + PAD, x + PAD], p[y + PAD, x + 1 + PAD]
                for k in range(reach):
                    if x - k >= 0:
                        _mark(edge, y, x - k, 0, here < there, k, here)
                    if x + 1 + k < width:
                        _mark(edge, y, x + 1 + k, 1, there < here, k, there)
            if column_jumps[y, x]:
                here, there = p[y + PAD, x + PAD], p[y + 1 + PAD, x + PAD]
                for k in range(reach):
                    if y - k >= 0:
                        _mark(edge, y - k, x, 2, here < there, k, here)
                    if y + 1 + k < height:
                        _mark(edge, y + 1 + k, x, 3, there < here, k, there)
            if row_jumps[y, x] or column_jumps[y, x]:
                for yy in range(max(y - NEAR, 0), min(y + NEAR + 2, height)):
                    for xx in range(max(x - NEAR, 0), min(x + NEAR + 2, width)):
                        near[yy, xx] = True


@loop()
def mark_creases(p, fraction, near):
    """
    Mark the pixels near sharp bends of a surface in `near`, (H, W) bool.

    A small pose error decides whether such a bend is seen as a jump. `p` is as for `mark_edges`; a
    second difference larger than `fraction` of the inverse depth is a sharp bend.
    """
    height, width = near.shape
    reach = _CREASE_NEAR
    for y in range(height):
        for x in range(width):
            j, i = y + PAD, x + PAD
            here = p[j, i]
            if here <= 0:
                continue
            bent = False
            if p[j, i - 1] > 0 and p[j, i + 1] > 0:
                bent |= abs(p[j, i + 1] + p[j, i - 1] - 2 * here) > fraction * here
            if p[j - 1, i] > 0 and p[j + 1, i] > 0:
                bent |= abs(p[j + 1, i] + p[j - 1, i] - 2 * here) > fraction * here
            if bent:
                for yy in range(max(y - reach, 0), min(y + reach + 1, height)):
                    for xx in range(max(x - reach, 0), min(x + reach + 1, width)):
                        near[yy, xx] = True


@njit(inline='always')
def _mark(edge, y, x, direction, far, k, inverse):
    if inverse > 0 and (edge[y, x] < 0 or (k == 0 and edge[y, x] % 2 == 1)):
        edge[y, x] = (direction * 2 + (1 if far else 0)) * 2 + (0 if k == 0 else 1)


@loop()
def concavity(p, step):
    """
    Return how far a pixel lies behind the mean of its neighbours, as a fraction of its distance.

    The four neighbours are `step` pixels away; `p` is as for `mark_edges`. The result is (H, W)
    float32, positive in concave corners, 0 on planes, NaN where a neighbour is missing or on
    another surface.
    """
    height, width = p.shape[0] - 2 * PAD, p.shape[1] - 2 * PAD
    out = np.full((height, width), np.nan, np.float32)
    for y in range(step, height - step):
        for x in range(step, width - step):
            here = p[y + PAD, x + PAD]
            total = np.float32(0.0)
            good = here > 0
            for dy, dx in ((0, step), (0, -step), (step, 0), (-step, 0)):
                other = p[y + dy + PAD, x + dx + PAD]
                good &= abs(other - here) < _BEND * here
                total += other - here
            if good:
                out[y, x] = np.float32(0.25) * total / here
    return out

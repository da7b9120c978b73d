"""Depths at jumps that a displaced edge cannot give: between the surfaces, and switching sides."""

from flexx2_sim_ros.gap.calibration.features import FEATURES
from flexx2_sim_ros.gap.data.pixel_kernels import EDGE_REACH
from flexx2_sim_ros.physics.compiled import loop
from numba import njit
import numpy as np

# Compiled code takes constants from its module.
_CLEAR = np.float32(FEATURES.gross)
VALID, BETWEEN, PAIRS, SWITCHES = range(4)


@loop()
def count_at_jumps(depth, clean, sigma, ends, follows, sides, out):
    """
    Count depths between the surfaces at a jump, and changes from one surface to the other.

    The pixels around a jump are counted together, so that an edge that lies elsewhere by a part of
    a pixel changes little. `depth` is one frame, NaN where invalid; `depth`, `clean` and `sigma`
    are (H, W) float32 metres.

    * `ends`: (2, H, W) float32 metres, how near and how far the surfaces around a pixel are; NaN
      for pixels that do not count.
    * `follows`: whether ``sides`` is of the frame before, with the same clean depth.
    * `sides`: (H, W) int8, changed: 1 on the near surface, 2 on the far one, 0 unknown.
    * `out`: (4,) float64, added to: valid depths, depths that no surface around has, pairs of
      successive depths, and those of them that switch to the other surface.
    """
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            z, near, far = depth[y, x], ends[0, y, x], ends[1, y, x]
            if z != z or near != near:
                sides[y, x] = 0
                continue
            margin = _CLEAR * sigma[y, x]
            out[VALID] += 1
            if z - near > margin and far - z > margin and _is_apart(z, clean, y, x, margin):
                out[BETWEEN] += 1
            side = 0
            if far - near > 2 * margin:
                side = 1 if z - near < far - z else 2
            if follows and side > 0 and sides[y, x] > 0:
                out[PAIRS] += 1
                out[SWITCHES] += side != sides[y, x]
            sides[y, x] = side


@njit(inline='always')
def _is_apart(z, clean, y, x, margin):
    # Whether no surface around a pixel is nearer to a depth than a margin.
    height, width = clean.shape
    for v in range(max(y - EDGE_REACH, 0), min(y + EDGE_REACH + 1, height)):
        for u in range(max(x - EDGE_REACH, 0), min(x + EDGE_REACH + 1, width)):
            if abs(z - clean[v, u]) <= margin:  # False for NaN.
                return False
    return True

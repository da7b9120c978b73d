"""
Surfaces in a depth image: where they break off, and how they are inclined.

Everything works on inverse depth p = 1/z. A plane's inverse depth is an affine function of the
pixel coordinates, so differences of p are exact on planes at any slant, and a jump is what the
slopes on either side do not explain.
"""

from dataclasses import dataclass

from flexx2_sim_ros.formulas import surfaces
from flexx2_sim_ros.physics.compiled import compiled, inlined, loop
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.sensor import Sensor
import numpy as np

PAD = 2
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
# Depths beyond these (FLT_MAX for "none", a zero with a rounding error) mean no return; between
# them every product below stays within float32.
NEAREST = np.float32(1e-3)
FARTHEST = np.float32(1e5)

is_jump = compiled(surfaces.is_jump)
_inverse_depth = compiled(surfaces.inverse_depth)
_slope_between = compiled(surfaces.slope_between)
_cos_incidence = compiled(surfaces.cos_incidence)


@dataclass(frozen=True)
class Surface:
    """
    What the camera model needs to know of a clean depth image.

    Attributes
    ----------
    inverse_depth : numpy.ndarray
        (H + 4, W + 4) float32, 1/m, 0 without a return, with a border of zeros two pixels wide.
    row_jumps, column_jumps : numpy.ndarray
        (H, W) uint8, 1 where a depth jump lies between pixels (y, x) and (y, x + 1), or (y + 1,
        x).
    cos_incidence : numpy.ndarray
        (H, W) float32, cosine of the angle between a pixel's ray and its surface normal; 1
        without a return.

    """

    inverse_depth: np.ndarray
    row_jumps: np.ndarray
    column_jumps: np.ndarray
    cos_incidence: np.ndarray

    @property
    def incidence(self) -> np.ndarray:
        """Return the incidence angle, (H, W) float32, radians in [0, pi/2]."""
        return np.arccos(np.clip(self.cos_incidence, 0.0, 1.0))


def analyse(depth: np.ndarray, intrinsics: Intrinsics, sensor: Sensor) -> Surface:
    """
    Find the depth jumps and incidence angles of a clean depth image.

    ``depth`` is (H, W) float32, metres along the optical axis. NaN, infinities, zero and negative
    values mean no return. Distortion in ``intrinsics`` is not used; ``sensor`` has the thresholds
    of depth jumps.
    """
    return Surface(*_analyse(depth, analysis_constants(intrinsics, sensor)))


def analysis_constants(intrinsics: Intrinsics, sensor: Sensor) -> tuple[np.float32, ...]:
    """Return what `surface_arrays` needs: ``jump_share, steep_share, fx, fy, cx, cy``."""
    shares, lens = (sensor.jump_share, sensor.steep_share), intrinsics
    return tuple(map(np.float32, (*shares, lens.fx, lens.fy, lens.cx, lens.cy)))


@loop(error_model='numpy')
def invert(depth, out):
    """Write 1/depth into the inside of the padded ``out``; 0 where depth is not a distance."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            out[y + PAD, x + PAD] = _inverse_depth(depth[y, x], NEAREST, FARTHEST)


@loop(error_model='numpy', fastmath=FAST)
def find_jumps(p, jump_share, steep_share, row_jumps, column_jumps):
    """Flag the depth jumps to the right of and below every pixel (the image border is none)."""
    height, width = row_jumps.shape
    for y in range(height):
        row = p[y + PAD]
        for x in range(width - 1):
            i = x + PAD
            row_jumps[y, x] = is_jump(
                row[i - 1], row[i], row[i + 1], row[i + 2], jump_share, steep_share
            )
    for y in range(height - 1):
        j = y + PAD
        for x in range(width):
            i = x + PAD
            column_jumps[y, x] = is_jump(
                p[j - 1, i], p[j, i], p[j + 1, i], p[j + 2, i], jump_share, steep_share
            )


@inlined
def slope(p2, p1, p0, n1, n2, jump_share, steep_share):
    """Return the slope of inverse depth at the middle of five pixels in a line."""
    jump_before = is_jump(p2, p1, p0, n1, jump_share, steep_share)
    jump_after = is_jump(p1, p0, n1, n2, jump_share, steep_share)
    return _slope_between(p2, p1, p0, n1, n2, jump_before, jump_after)


@inlined  # A loop within another loop is optimised twice, and rounds in another way.
def find_incidence(p, row_jumps, column_jumps, fx, fy, cx, cy, out):
    """Write the cosine of the incidence angle of every pixel, with the jumps of `find_jumps`."""
    height, width = out.shape
    # Whether a jump lies before each pixel of a row, and after the last one: surfaces end at the
    # image's border.
    across = np.ones(width + 1, np.uint8)
    border = np.ones(width, np.uint8)
    for y in range(height):
        j = y + PAD
        for x in range(width - 1):  # a slice would take numba 5 s longer to compile
            across[x + 1] = row_jumps[y, x]
        above = column_jumps[y - 1] if y > 0 else border
        below = column_jumps[y] if y < height - 1 else border
        v = np.float32(y) - cy
        ry = v / fy
        for x in range(width):
            i = x + PAD
            here = p[j, i]
            du = _slope_between(
                p[j, i - 2],
                p[j, i - 1],
                here,
                p[j, i + 1],
                p[j, i + 2],
                across[x] != 0,
                across[x + 1] != 0,
            )
            dv = _slope_between(
                p[j - 2, i],
                p[j - 1, i],
                here,
                p[j + 1, i],
                p[j + 2, i],
                above[x] != 0,
                below[x] != 0,
            )
            u = np.float32(x) - cx
            out[y, x] = _cos_incidence(here, du, dv, u, v, u / fx, ry, fx, fy)


@inlined
def surface_arrays(depth, constants):
    """Return the arrays of a `Surface` of (H, W) float32 depth."""
    height, width = depth.shape
    jump_share, steep_share, fx, fy, cx, cy = constants
    inverse = np.zeros((height + 2 * PAD, width + 2 * PAD), np.float32)
    invert(depth, inverse)
    row_jumps = np.zeros((height, width), np.uint8)
    column_jumps = np.zeros((height, width), np.uint8)
    find_jumps(inverse, jump_share, steep_share, row_jumps, column_jumps)
    cosine = np.empty((height, width), np.float32)
    find_incidence(inverse, row_jumps, column_jumps, fx, fy, cx, cy, cosine)
    return inverse, row_jumps, column_jumps, cosine


@loop(error_model='numpy', fastmath=FAST)
def _analyse(depth, constants):
    return surface_arrays(depth, constants)


@loop(error_model='numpy', fastmath=FAST)
def find_slopes(p, jump_share, steep_share, across, down):
    """Write the slopes of inverse depth, 1/m a pixel, along rows and along columns; (H, W)."""
    height, width = across.shape
    for y in range(height):
        j = y + PAD
        for x in range(width):
            i = x + PAD
            here = p[j, i]
            across[y, x] = slope(
                p[j, i - 2], p[j, i - 1], here, p[j, i + 1], p[j, i + 2], jump_share, steep_share
            )
            down[y, x] = slope(
                p[j - 2, i], p[j - 1, i], here, p[j + 1, i], p[j + 2, i], jump_share, steep_share
            )


def tangents(depth: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the tangent plane of every pixel of a depth image.

    That is inverse depth padded by a border of two pixels (0 for nothing), and its slopes along
    rows and columns, (H, W) float32, 1/m and 1/m a pixel. ``depth`` is (H, W) float32, metres;
    whatever is no distance means nothing. ``sensor`` has the thresholds of depth jumps.
    """
    height, width = depth.shape
    inverse = np.zeros((height + 2 * PAD, width + 2 * PAD), np.float32)
    invert(np.ascontiguousarray(depth), inverse)
    across, down = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    find_slopes(
        inverse, np.float32(sensor.jump_share), np.float32(sensor.steep_share), across, down
    )
    return inverse, across, down

"""Pose error: a camera that is not where it is thought to be."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas import surfaces
from flexx2_sim_ros.formulas.scalars import f32, floor, i32, least, most, size, where
from flexx2_sim_ros.physics.compiled import compiled, inlined, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.physics.poses import rotation_of
from flexx2_sim_ros.physics.surface import PAD, tangents
import numpy as np

NEAREST = f32(1e-3)  # depth of a point that the other camera can see, over its depth in this one
# Surfaces beyond 1 / CLOSEST metres, at most MOST_STEPS pixels away, can come in front of a pixel.
CLOSEST = f32(10.0)
MOST_STEPS = 64
BLOCK = 8  # side of the squares of pixels for which it is looked up what their rays can meet
_SLACK = f32(0.01)  # pixels, more than places are rounded by
_MOST_OF = f32(0.9)
_MARGIN = f32(2.0)  # steps: one, in which two inverse depths are near, and one cut short
_TINY = f32(1e-9)
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)
_NAN = f32(math.nan)


def turned_ray(
    first: np.ndarray, second: np.ndarray, third: np.ndarray, x: float, y: float
) -> tuple[float, float, float]:
    """Return the ray (x, y, 1) turned by the rotation with these three rows."""
    return (
        first[0] * x + first[1] * y + first[2],
        second[0] * x + second[1] * y + second[2],
        third[0] * x + third[1] * y + third[2],
    )


def depth_ratio(dz: float, step_z: float, inverse: float) -> float:
    """
    Return a point's depth in the other camera over its depth in this one.

    ``dz`` is of the turned ray to the point, ``step_z`` from one camera to the other, metres, and
    ``inverse`` the point's inverse depth in this camera, 1/m; 0, infinitely far, needs no special
    case.
    """
    return dz + step_z * inverse


def place_at(
    direction: float, step: float, inverse: float, far: float, focal: float, centre: float
) -> float:
    """
    Return the place along a row or column, in pixels, at which the other camera sees a point.

    ``direction`` of the ray to the point is in the other camera's frame, ``step`` from one camera
    to the other in metres, both along the row or column. ``inverse`` is the point's inverse depth
    in this camera, 1/m; ``far`` its depth in the other camera over that in this one. ``focal`` and
    ``centre`` (the principal point's) are in pixels.
    """
    return focal * (direction + step * inverse) / far + centre


def pixel_at(place: float, last: int) -> int:
    """Return the row or column, 0..last; what lies outside the image goes on as at its border."""
    return i32(least(most(floor(place + _HALF), _ZERO), f32(last)))


def parallax(first: float, second: float, other_first: float, other_second: float) -> float:
    """Return how far apart two places in an image are, along the row or column, pixels."""
    return most(size(other_first - first), size(other_second - second))


def closest_seen(dz: float, step_z: float) -> float:
    """Return the largest inverse depth, 1/m, at which both cameras see a point of a ray."""
    behind = where(step_z < _ZERO, _MOST_OF * dz / most(-step_z, _TINY), CLOSEST)
    return least(behind, CLOSEST)


def is_near(here: float, inverse: float, within: float) -> bool:
    """Say whether two inverse depths differ by at most ``within``."""
    return size(here - inverse) <= within


def depth_of_plane(
    nx: float,
    ny: float,
    nz: float,
    dx: float,
    dy: float,
    dz: float,
    step_x: float,
    step_y: float,
    step_z: float,
) -> float:
    """Return the depth at which a ray d from a step hits the plane n . X = 1, NaN if not."""
    seen = nx * dx + ny * dy + nz * dz
    left = _ONE - nx * step_x - ny * step_y - nz * step_z
    return where(least(seen, left) > _ZERO, left / seen, _NAN)


_turned_ray = compiled(turned_ray)
_depth_ratio = compiled(depth_ratio)
_place_at = compiled(place_at)
_pixel_at = compiled(pixel_at)
_parallax = compiled(parallax)
_closest_seen = compiled(closest_seen)
_is_near = compiled(is_near)
_depth_of_plane = compiled(depth_of_plane)
_plane_normal = compiled(surfaces.plane_normal)


@dataclass(frozen=True)
class PoseError(Effect):
    """A camera that is not where it is thought to be."""

    name: ClassVar[str] = 'pose_error'
    stage: ClassVar[Stage] = Stage.GEOMETRY
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'wrong extrinsics or registration: the camera is not at the given pose'
    covariate: ClassVar[str] = 'image'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'amplitude', 'edges')
    source: ClassVar[str] = 'the paper set distances to 10 mm; angles are assumed'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (Hypothesis('', ()),)
    role: ClassVar[str] = 'pose'
    smooth: ClassVar[bool] = True
    family: ClassVar[str] = 'rigid motion'
    picture: ClassVar[Picture] = Picture('along_row')
    batched: ClassVar[tuple[str, ...] | None] = ('pose',)

    x: float = parameter(0.002, -0.2, 0.2, 'm', 'moved to the right')
    y: float = parameter(0.002, -0.2, 0.2, 'm', 'moved down')
    z: float = parameter(0.005, -0.2, 0.2, 'm', 'moved forward')
    pitch_deg: float = parameter(0.25, -10.0, 10.0, 'deg', 'turned about x')
    yaw_deg: float = parameter(0.25, -10.0, 10.0, 'deg', 'turned about y')
    roll_deg: float = parameter(0.1, -10.0, 10.0, 'deg', 'turned about z')

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the (3, 3) rotation and the (3,) step in metres from where it should be."""
        turn = np.radians([self.pitch_deg, self.yaw_deg, self.roll_deg]) * self.strength
        return rotation_of(turn), np.array([self.x, self.y, self.z]) * self.strength

    def apply(self, state: FrameState) -> None:
        """See the scene from the other pose."""
        rotation, step = self.motion()
        camera = state.intrinsics
        height, width = state.depth.shape
        depth = np.empty((height, width), np.float32)
        index = np.empty((height, width), np.int32)
        inverse, *slopes = tangents(state.depth, state.mode.sensor)
        motion = (
            tuple(map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy))),
            tuple(tuple(row) for row in rotation.astype(np.float32)),
            tuple(step.astype(np.float32)),
        )
        fronts = np.empty((2, -(-height // BLOCK), -(-width // BLOCK)), np.float32)
        _find_fronts(inverse, *motion, *fronts)
        _look_from(inverse, *slopes, *motion, *fronts, depth, index)
        state.depth = depth
        if state.reflectivity.size > 1:
            state.reflectivity = state.reflectivity.take(index)


@inlined
def _shown_at(p, dx, dy, dz, lens, step, inverse, height, width):
    # The inverse depth of the surface that the old image shows where it sees a point of a ray.
    fx, fy, cx, cy = lens
    ratio = _depth_ratio(dz, step[2], inverse)
    column = _pixel_at(_place_at(dx, step[0], inverse, ratio, fx, cx), np.int32(width - 1))
    row = _pixel_at(_place_at(dy, step[1], inverse, ratio, fy, cy), np.int32(height - 1))
    return p[row + PAD, column + PAD]


@inlined
def _in_front(p, dx, dy, dz, lens, step, inverse, nearest, height, width):
    # The inverse depth of the point of a ray whose place in the old image shows what is seen: of
    # the nearest surface that the ray meets, else ``inverse``, the pixel's own one before. A ray
    # is followed from near to far, about one pixel of the old image at a time. A surface that was
    # hidden there goes on from the last pixel that was not. All points that are nearer than
    # ``nearest``, the largest inverse depth of the image, are free: they are skipped.
    fx, fy, cx, cy = lens
    closest = _closest_seen(dz, step[2])
    far, close = _depth_ratio(dz, step[2], inverse), _depth_ratio(dz, step[2], closest)
    if inverse >= closest or far < NEAREST or close < NEAREST:
        return inverse
    path = _parallax(
        _place_at(dx, step[0], inverse, far, fx, cx),
        _place_at(dy, step[1], inverse, far, fy, cy),
        _place_at(dx, step[0], closest, close, fx, cx),
        _place_at(dy, step[1], closest, close, fy, cy),
    )
    pixel = (closest - inverse) / max(path, _ONE)
    steps = np.int32(min(path + _HALF, np.float32(MOST_STEPS)))
    free = inverse
    reach = (nearest - inverse) / pixel + _MARGIN
    if reach < np.float32(steps):
        steps = np.int32(reach)
        free = min(inverse + np.float32(steps + 1) * pixel, closest)
    for k in range(steps, 0, -1):
        there = min(inverse + np.float32(k) * pixel, closest)
        here = _shown_at(p, dx, dy, dz, lens, step, there, height, width)
        if _is_near(here, there, pixel):
            again = _shown_at(p, dx, dy, dz, lens, step, here, height, width)
            if _is_near(again, here, _HALF * pixel):
                return here
        if here < there:
            free = there
    if steps > 0 and (
        _shown_at(p, dx, dy, dz, lens, step, inverse, height, width) > inverse + pixel
    ):
        return free
    return inverse


@inlined
def _ray_of(lens, rotation, x, y):
    # The ray of a pixel of the moved camera, in the old camera's frame.
    fx, fy, cx, cy = lens
    first, second, third = rotation
    return _turned_ray(first, second, third, (np.float32(x) - cx) / fx, (np.float32(y) - cy) / fy)


@inlined
def _place_of(lens, dx, dy, step, inverse, far):
    # Where the old camera sees a point of a ray: column and row.
    fx, fy, cx, cy = lens
    return (
        _place_at(dx, step[0], inverse, far, fx, cx),
        _place_at(dy, step[1], inverse, far, fy, cy),
    )


@inlined
def _depths_of_block(p, i, j, height, width):
    # The smallest and the largest inverse depth of a block of the image.
    low, high = np.float32(np.inf), _ZERO
    for y in range(BLOCK * i, min(BLOCK * i + BLOCK, height)):
        for x in range(BLOCK * j, min(BLOCK * j + BLOCK, width)):
            here = p[y + PAD, x + PAD]
            low, high = min(low, here), max(high, here)
    return low, high


@inlined
def _box_of_places(low, closest, lens, rotation, step, ends):
    # The columns and rows, from and to, at which the old image shows the rays of a block between
    # two inverse depths, and whether it does. Places are quotients of two functions that are
    # linear in column, row and inverse depth: they are largest and smallest in the corners.
    left, top = np.float32(np.inf), np.float32(np.inf)
    right, bottom = -left, -top
    seen = True
    for y in ends[2:]:
        for x in ends[:2]:
            dx, dy, dz = _ray_of(lens, rotation, x, y)
            for inverse in (low, closest):
                far = _depth_ratio(dz, step[2], inverse)
                seen &= far > NEAREST + NEAREST
                column, row = _place_of(lens, dx, dy, step, inverse, far)
                left, right = min(left, column), max(right, column)
                top, bottom = min(top, row), max(bottom, row)
    return left, right, top, bottom, seen


@loop(error_model='numpy')
def _find_fronts(p, lens, rotation, step, front, room):
    # For each block of pixels of the moved camera: the largest inverse depth that the old image
    # shows anywhere along their rays, and how much nearer than a pixel's own it may be for the
    # ray not to be cut off before it (less than a step of `_in_front`); infinite and 0 where the
    # rays are not all seen.
    rows, columns = front.shape
    height, width = p.shape[0] - 2 * PAD, p.shape[1] - 2 * PAD
    low, high = np.empty_like(front), np.empty_like(front)
    for i in range(rows):
        for j in range(columns):
            low[i, j], high[i, j] = _depths_of_block(p, i, j, height, width)
    for i in range(rows):
        for j in range(columns):
            ends = (
                BLOCK * j,
                min(BLOCK * j + BLOCK, width) - 1,
                BLOCK * i,
                min(BLOCK * i + BLOCK, height) - 1,
            )
            least_z, most_z = np.float32(np.inf), np.float32(-np.inf)
            for y in ends[2:]:
                for x in ends[:2]:
                    dz = _ray_of(lens, rotation, x, y)[2]
                    least_z, most_z = min(least_z, dz), max(most_z, dz)
            closest = _closest_seen(most_z, step[2])
            left, right, top, bottom, seen = _box_of_places(
                low[i, j], closest, lens, rotation, step, ends
            )
            space = _closest_seen(least_z, step[2]) - high[i, j]
            front[i, j], room[i, j] = np.float32(np.inf), _ZERO
            if not seen or space <= _ZERO:
                continue
            first = _pixel_at(left - _SLACK, np.int32(width - 1)) // BLOCK
            last = _pixel_at(right + _SLACK, np.int32(width - 1)) // BLOCK
            above = _pixel_at(top - _SLACK, np.int32(height - 1)) // BLOCK
            below = _pixel_at(bottom + _SLACK, np.int32(height - 1)) // BLOCK
            front[i, j] = high[above : below + 1, first : last + 1].max()
            room[i, j] = _MOST_OF * space / max(max(right - left, bottom - top), _ONE)


@inlined
def _is_same(place, other):
    # Whether all places between two are in the same row or column, whatever their rounding.
    low, high = min(place, other) - _SLACK, max(place, other) + _SLACK
    return np.floor(low + _HALF) == np.floor(high + _HALF)


@loop(error_model='numpy', fastmath=FAST)
def _look_from(p, across, down, lens, rotation, step, front, room, depth, index):
    # A point X of the moved camera is rotation X + step in the old one, where the plane seen by a
    # pixel is n . X = 1. Which pixel that is, is found from the depth the ray had before, or that
    # of a surface that has come in front of it. A ray is followed only where such a surface could
    # show the ray in another pixel of the old image.
    height, width = depth.shape
    fx, fy, cx, cy = lens
    last_column, last_row = np.int32(width - 1), np.int32(height - 1)
    nearest = p.max()
    columns, rows = np.empty(width, np.int32), np.empty(width, np.int32)
    hidden = np.empty(width, np.bool_)
    fronts, rooms = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height):
        if y % BLOCK == 0:
            for x in range(width):
                fronts[x], rooms[x] = front[y // BLOCK, x // BLOCK], room[y // BLOCK, x // BLOCK]
        for x in range(width):
            dx, dy, dz = _ray_of(lens, rotation, x, y)
            before = p[y + PAD, x + PAD]
            ahead = max(before, fronts[x])
            far = _depth_ratio(dz, step[2], before)
            place_x, place_y = _place_of(lens, dx, dy, step, before, far)
            other_x, other_y = _place_of(
                lens, dx, dy, step, ahead, _depth_ratio(dz, step[2], ahead)
            )
            columns[x], rows[x] = _pixel_at(place_x, last_column), _pixel_at(place_y, last_row)
            hidden[x] = not (
                (ahead - before <= rooms[x])
                & _is_same(place_x, other_x)
                & _is_same(place_y, other_y)
            )
        for x in range(width):
            if hidden[x]:
                dx, dy, dz = _ray_of(lens, rotation, x, y)
                before = p[y + PAD, x + PAD]
                inverse = _in_front(p, dx, dy, dz, lens, step, before, nearest, height, width)
                far = _depth_ratio(dz, step[2], inverse)
                place_x, place_y = _place_of(lens, dx, dy, step, inverse, far)
                columns[x] = _pixel_at(place_x, last_column)
                # Not behind the camera it was.
                rows[x] = _pixel_at(place_y, last_row) if far >= NEAREST else -1
        for x in range(width):
            dx, dy, dz = _ray_of(lens, rotation, x, y)
            column, row = columns[x], max(rows[x], np.int32(0))
            here = p[row + PAD, column + PAD]
            u, v = np.float32(column) - cx, np.float32(row) - cy
            nx, ny, nz = _plane_normal(here, across[row, column], down[row, column], u, v, fx, fy)
            value = _depth_of_plane(nx, ny, nz, dx, dy, dz, step[0], step[1], step[2])
            seen = rows[x] >= 0
            depth[y, x] = value if seen and here > _ZERO else _NAN
            index[y, x] = row * width + column if seen else 0

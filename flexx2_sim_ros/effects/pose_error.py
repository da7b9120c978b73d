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
from flexx2_sim_ros.physics.surface import PAD, tangents
import numpy as np

NEAREST = f32(1e-3)  # depth of a point that the other camera can see, over its depth in this one
# Surfaces beyond 1 / CLOSEST metres, at most MOST_STEPS pixels away, can come in front of a pixel.
CLOSEST = f32(10.0)
MOST_STEPS = 64
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

    Parameters
    ----------
    dz : float
        Of the turned ray to the point.
    step_z : float
        From one camera to the other, metres.
    inverse : float
        The point's inverse depth in this camera, 1/m; 0, infinitely far, needs no special case.

    """
    return dz + step_z * inverse


def place_at(
    direction: float, step: float, inverse: float, far: float, focal: float, centre: float
) -> float:
    """
    Return the place along a row or column, in pixels, at which the other camera sees a point.

    Parameters
    ----------
    direction : float
        Of the ray to the point in the other camera's frame, along the row or column.
    step : float
        From one camera to the other in this direction, metres.
    inverse : float
        The point's inverse depth in this camera, 1/m.
    far : float
        Its depth in the other camera over that in this one.
    focal, centre : float
        Focal length and principal point, pixels.

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
        _look_from(
            *tangents(state.depth, state.mode.sensor),
            np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32),
            rotation.astype(np.float32),
            step.astype(np.float32),
            depth,
            index,
        )
        state.depth = depth
        if state.reflectivity.size > 1:
            state.reflectivity = state.reflectivity.ravel()[index]


def rotation_of(turn: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation about an axis (3,) by its length, radians (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


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
    pixel = (closest - inverse) / most(path, _ONE)
    steps = np.int32(least(path + _HALF, np.float32(MOST_STEPS)))
    free = inverse
    reach = (nearest - inverse) / pixel + _MARGIN
    if reach < np.float32(steps):
        steps = np.int32(reach)
        free = least(inverse + np.float32(steps + 1) * pixel, closest)
    for k in range(steps, 0, -1):
        there = least(inverse + np.float32(k) * pixel, closest)
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


@loop(error_model='numpy', fastmath=FAST)
def _look_from(p, across, down, lens, rotation, step, depth, index):
    # A point X of the moved camera is rotation X + step in the old one, where the plane seen by a
    # pixel is n . X = 1. Which pixel that is, is found from the depth the ray had before, or that
    # of a surface that has come in front of it.
    height, width = depth.shape
    fx, fy, cx, cy = lens
    first, second, third = rotation
    nearest = p.max()
    for y in range(height):
        for x in range(width):
            ray_x, ray_y = (np.float32(x) - cx) / fx, (np.float32(y) - cy) / fy
            dx, dy, dz = _turned_ray(first, second, third, ray_x, ray_y)
            before = p[y + PAD, x + PAD]
            inverse = _in_front(p, dx, dy, dz, lens, step, before, nearest, height, width)
            far = _depth_ratio(dz, step[2], inverse)
            index[y, x] = 0
            depth[y, x] = _NAN
            if far < NEAREST:
                continue  # Behind the camera it was.
            place_x = _place_at(dx, step[0], inverse, far, fx, cx)
            place_y = _place_at(dy, step[1], inverse, far, fy, cy)
            column = _pixel_at(place_x, np.int32(width - 1))
            row = _pixel_at(place_y, np.int32(height - 1))
            index[y, x] = row * width + column
            here = p[row + PAD, column + PAD]
            if here > _ZERO:
                u, v = np.float32(column) - cx, np.float32(row) - cy
                nx, ny, nz = _plane_normal(
                    here, across[row, column], down[row, column], u, v, fx, fy
                )
                depth[y, x] = _depth_of_plane(nx, ny, nz, dx, dy, dz, step[0], step[1], step[2])

"""Pose error: a camera that is not where it is thought to be."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.physics.surface import PAD, tangents
from numba import njit
import numpy as np

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_NAN = np.float32(np.nan)
_HALF = np.float32(0.5)
_NEAREST = np.float32(1e-3)


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


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _look_from(p, across, down, lens, rotation, step, depth, index):
    # A point X of the moved camera is rotation X + step in the old one, where the plane seen by a
    # pixel is n . X = 1. Which pixel that is, is found from the depth the ray had before.
    height, width = depth.shape
    fx, fy, cx, cy = lens
    for y in range(height):
        for x in range(width):
            ray_x, ray_y = (np.float32(x) - cx) / fx, (np.float32(y) - cy) / fy
            dx = rotation[0, 0] * ray_x + rotation[0, 1] * ray_y + rotation[0, 2]
            dy = rotation[1, 0] * ray_x + rotation[1, 1] * ray_y + rotation[1, 2]
            dz = rotation[2, 0] * ray_x + rotation[2, 1] * ray_y + rotation[2, 2]
            inverse = p[y + PAD, x + PAD]
            # Divided by depth, so that nothing (infinitely far) needs no case of its own.
            far = dz + step[2] * inverse
            index[y, x] = 0
            depth[y, x] = _NAN
            if far < _NEAREST:
                continue  # Behind the camera it was.
            u = fx * (dx + step[0] * inverse) / far + cx
            v = fy * (dy + step[1] * inverse) / far + cy
            # What lies outside the image goes on as at its border.
            column = int(min(max(np.floor(u + _HALF), _ZERO), np.float32(width - 1)))
            row = int(min(max(np.floor(v + _HALF), _ZERO), np.float32(height - 1)))
            index[y, x] = row * width + column
            here = p[row + PAD, column + PAD]
            if here > _ZERO:
                du, dv = across[row, column], down[row, column]
                nx, ny = fx * du, fy * dv
                nz = here - (np.float32(column) - cx) * du - (np.float32(row) - cy) * dv
                seen = nx * dx + ny * dy + nz * dz
                left = _ONE - nx * step[0] - ny * step[1] - nz * step[2]
                if seen > _ZERO and left > _ZERO:
                    depth[y, x] = left / seen

"""The cameras of a MuJoCo model: their ids, what they see, and their clipping planes."""

import copy

from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.visibility import unseen_geoms
import mujoco
import numpy as np

# Visible geom groups, as in MuJoCo's viewer: 0 to 2. By convention, groups from 3 on hold
# collision shapes, which are inside the visible ones.
VISIBLE_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
INVISIBLE = 5


class ModelCameras:
    """
    The cameras of a model by name, each checked once against the intrinsics that all must have.

    ``model`` is a copy. After `select`, only the geoms that one camera can see are visible in it.
    """

    def __init__(self, model: mujoco.MjModel, intrinsics: Intrinsics) -> None:
        """Copy the model."""
        self.model = copy.copy(model)
        self._groups = model.geom_group.copy()
        self._intrinsics = intrinsics
        self._found: dict[str, tuple[int, np.ndarray]] = {}

    def select(self, name: str) -> int:
        """
        Make visible what a camera can see; return the camera's id.

        Raises InputError when the model has no such camera or it has other intrinsics.
        """
        if name not in self._found:
            index = self._find(name)
            hidden = unseen_geoms(self.model, index, self._intrinsics)
            self._found[name] = index, np.where(hidden, INVISIBLE, self._groups)
        index, self.model.geom_group[:] = self._found[name]
        return index

    def _find(self, name: str) -> int:
        model, wanted = self.model, self._intrinsics
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if index < 0:
            names = ', '.join(model.cam(i).name for i in range(model.ncam))
            raise InputError(
                f'camera: must be one of {unquoted(names, 400) or "none: no camera"}, got '
                f'{shown(name)}'
            )
        size = (wanted.width, wanted.height)
        focal = np.zeros(4)
        if all(model.cam_sensorsize[index]):
            focal = model.cam_intrinsic[index] / np.tile(model.cam_sensorsize[index] / size, 2)
        asked = (wanted.fx, wanted.fy, 0.0, 0.0)
        if tuple(model.cam_resolution[index]) != size or not np.allclose(focal, asked, atol=1e-3):
            raise InputError(
                f'camera {name}: must have resolution {size} and focal length {asked[:2]} px, '
                f'centred, got {tuple(model.cam_resolution[index])} and {focal[:2]}'
            )
        return index


def clip_planes(model: mujoco.MjModel) -> tuple[float, float]:
    """Return the distance of the near and the far clipping plane, metres."""
    extent = model.stat.extent
    return float(model.vis.map.znear * extent), float(model.vis.map.zfar * extent)

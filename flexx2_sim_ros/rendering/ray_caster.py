"""Depth and geom ids by ray casting: exact, and without a graphics library."""

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.culling import exact_for_rays
from flexx2_sim_ros.rendering.model_cameras import clip_planes, ModelCameras, VISIBLE_GROUPS
from flexx2_sim_ros.rendering.visibility import pixel_directions
import mujoco
import numpy as np


class RayCaster:
    """
    A `DepthRenderer` that casts one exact ray for each pixel.

    Parameters
    ----------
    model : mujoco.MjModel
        Copied.
    intrinsics : Intrinsics
        Of every camera.
    reasons : tuple of str
        Why better backends cannot be used.

    """

    backend = 'ray'

    def __init__(
        self, model: mujoco.MjModel, intrinsics: Intrinsics, reasons: tuple[str, ...]
    ) -> None:
        """Compute the rays of the pixels."""
        self.reasons = reasons
        self._cameras = ModelCameras(exact_for_rays(model), intrinsics)
        self._model = self._cameras.model
        self._shape = (intrinsics.height, intrinsics.width)
        rays = pixel_directions(intrinsics).reshape(-1, 3)
        length = np.linalg.norm(rays, axis=1)
        self._rays = rays / length[:, None]
        self._cosine = 1.0 / length
        self._world = np.empty_like(self._rays)
        self._distance = np.empty(length.size)
        self._geom_id = np.empty(length.size, np.int32)

    def render(self, data: mujoco.MjData, camera: str) -> tuple[np.ndarray, np.ndarray]:
        """Render one camera, see `DepthRenderer.render`."""
        index = self._cameras.select(camera)
        near, far = clip_planes(self._model)
        np.dot(self._rays, data.cam_xmat[index].reshape(3, 3).T, out=self._world)
        mujoco.mj_multiRay(
            m=self._model,
            d=data,
            pnt=data.cam_xpos[index],
            vec=self._world.ravel(),
            geomgroup=VISIBLE_GROUPS,
            flg_static=1,
            bodyexclude=-1,
            geomid=self._geom_id,
            dist=self._distance,
            normal=None,
            nray=self._geom_id.size,
            cutoff=far / self._cosine.min(),
        )
        depth = (self._distance * self._cosine).astype(np.float32)
        missed = ~((depth > near) & (depth < far))
        depth[missed] = np.nan
        geom_id = np.where(missed, np.int32(-1), self._geom_id)
        return depth.reshape(self._shape), geom_id.reshape(self._shape)

    def close(self) -> None:
        """Nothing to release."""

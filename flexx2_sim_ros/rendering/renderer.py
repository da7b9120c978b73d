"""Open a renderer of exact depth and surface ids: OpenGL where it works, else ray casting."""

from typing import Protocol

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.model_cameras import (
    clip_planes,
    INVISIBLE,
    ModelCameras,
    VISIBLE_GROUPS,
)
from flexx2_sim_ros.rendering.opengl import OpenGlRenderer
from flexx2_sim_ros.rendering.ray_tiles import RayTiles
from flexx2_sim_ros.rendering.visibility import pixel_directions
import mujoco
import numpy as np


class RayCaster:
    """
    A `DepthRenderer` that casts one exact ray for each pixel.

    The model is copied. ``reasons`` are why better backends cannot be used.
    """

    backend = 'ray'

    def __init__(
        self, model: mujoco.MjModel, intrinsics: Intrinsics, reasons: tuple[str, ...]
    ) -> None:
        """Compute the rays of the pixels."""
        self.reasons = reasons
        self._cameras = ModelCameras(model, intrinsics)
        self._model = self._cameras.model
        # MuJoCo's own bounding volumes miss geoms, see `exact_for_rays`; those of tiles do not.
        self._model.body_bvhadr[:] = -1
        self._tiles = RayTiles(intrinsics)
        self._shape = (intrinsics.height, intrinsics.width)
        rays = pixel_directions(intrinsics).reshape(-1, 3)[self._tiles.order]
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
        seen = self._tiles.geoms(self._model, data, index)
        groups = np.where(seen, self._model.geom_group, INVISIBLE)
        for part, chosen in zip(self._tiles.parts, groups, strict=True):
            self._model.geom_group[:] = chosen
            mujoco.mj_multiRay(
                m=self._model,
                d=data,
                pnt=data.cam_xpos[index],
                vec=self._world[part].ravel(),
                geomgroup=VISIBLE_GROUPS,
                flg_static=1,
                bodyexclude=-1,
                geomid=self._geom_id[part],
                dist=self._distance[part],
                normal=None,
                nray=part.stop - part.start,
                cutoff=far / self._cosine.min(),
            )
        depth = np.empty(self._distance.size, np.float32)
        with np.errstate(over='ignore'):  # A robot may be anywhere.
            depth[self._tiles.order] = self._distance * self._cosine
        missed = ~((depth > near) & (depth < far))
        depth[missed] = np.nan
        geom_id = np.empty(depth.size, np.int32)
        geom_id[self._tiles.order] = self._geom_id
        geom_id[missed] = -1
        return depth.reshape(self._shape), geom_id.reshape(self._shape)

    def close(self) -> None:
        """Nothing to release."""


BACKENDS = ('auto', 'egl', 'osmesa', 'ray')
# What each OpenGL backend needs, for the message when it does not work.
_NEEDS = {
    'egl': 'libEGL with a driver (Debian: libegl1 libgl1-mesa-dri)',
    'osmesa': 'libOSMesa (Debian: libosmesa6)',
}


class DepthRenderer(Protocol):
    """
    What `open_renderer` returns.

    ``backend`` is ``egl``, ``osmesa`` or ``ray``; ``reasons`` are why each better one cannot be
    used, empty if this is the best one.
    """

    backend: str
    reasons: tuple[str, ...]

    def render(self, data: mujoco.MjData, camera: str) -> tuple[np.ndarray, np.ndarray]:
        """
        Render one camera.

        Parameters
        ----------
        data : mujoco.MjData
            A state of the model, complete up to its positions (``mj_forward`` or later).
        camera : str
            The camera's name.

        Returns
        -------
        depth : np.ndarray
            (H, W) float32, metres along the optical axis; NaN where there is no return before
            the far plane.
        geom_id : np.ndarray
            (H, W) int32, the visible geom, -1 for background.

        Raises
        ------
        InputError
            When the model has no such camera or it has other intrinsics.

        """

    def close(self) -> None:
        """Release the graphics context; `render` cannot be called after it."""


def open_renderer(
    model: mujoco.MjModel, intrinsics: Intrinsics, backend: str = 'auto'
) -> DepthRenderer:
    """
    Open the best renderer that works here.

    Parts of the robot that a camera can never see (`unseen_geoms`) are not rendered for it. An
    OpenGL renderer belongs to the thread that opened it and should be closed there; one that is
    dropped is closed. OpenGL draws round shapes with facets (``visual/quality`` in the model), so
    their depth is off by up to 0.6 % of their radius; the ray caster is exact. Where an object is
    nearer than the near plane, OpenGL sees through it, and the ray caster has no return.

    Parameters
    ----------
    model : mujoco.MjModel
        From `flexx2_sim_ros.robots.model.build_model`; copied, so later changes to it have no
        effect.
    intrinsics : Intrinsics
        Those that the model was built with.
    backend : str
        ``egl``, ``osmesa``, ``ray`` (``mj_multiRay``; no graphics library needed), or ``auto``:
        the first of them that works. Environment variables have no influence.

    Raises
    ------
    InputError
        For an unknown backend, or one that does not work here.

    """
    if backend not in BACKENDS:
        raise InputError(f'backend: must be one of {", ".join(BACKENDS)}, got {shown(backend)}')
    if backend == 'ray':
        return RayCaster(model, intrinsics, ())
    reasons: list[str] = []
    for name in ('egl', 'osmesa') if backend == 'auto' else (backend,):
        try:
            return OpenGlRenderer(model, intrinsics, name, tuple(reasons))
        except Exception as error:  # a missing or broken driver raises anything
            reasons.append(
                f'{name} does not work here, it needs {_NEEDS[name]} '
                f'[{type(error).__name__}: {error}]'
            )
    if backend != 'auto':
        raise InputError(f'backend: must be one that works here, or auto, got {reasons[0]}')
    return RayCaster(model, intrinsics, tuple(reasons))

"""Depth and geom ids with OpenGL, drawn off screen."""

from collections.abc import Iterator
from contextlib import contextmanager
import importlib
import os
import sys
from typing import Any
from weakref import finalize

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.model_cameras import clip_planes, ModelCameras, VISIBLE_GROUPS
import mujoco
import numpy as np

# An infinite plane is drawn with sides of this many metres: otherwise OpenGL draws it as thousands
# of squares.
_PLANE_SIZE = 1000.0


class OpenGlRenderer:
    """
    A `DepthRenderer` that draws every geom in the colour of its id and reads the depth buffer.

    The model is copied. ``backend`` is ``egl`` or ``osmesa``; ``reasons`` are why better ones
    cannot be used. Raises errors of any kind, when a library or driver is missing or broken.
    """

    def __init__(
        self, model: mujoco.MjModel, intrinsics: Intrinsics, backend: str, reasons: tuple[str, ...]
    ) -> None:
        """Create the context and the buffers."""
        self.backend = backend
        self.reasons = reasons
        self._cameras = ModelCameras(model, intrinsics)
        self._model = self._cameras.model
        planes = self._model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        # A plane may end in one direction and not in the other. The third size is that of squares.
        infinite = planes & (self._model.geom_size[:, :2].min(axis=1) <= 0)
        sizes = self._model.geom_size[infinite]
        sizes[:, 2] = _PLANE_SIZE
        sizes[sizes <= 0] = _PLANE_SIZE
        self._model.geom_size[infinite] = sizes
        self._gl = _gl_context(backend, intrinsics.width, intrinsics.height)
        try:
            self._gl.make_current()
            # MuJoCo loads OpenGL once per process. Without this variable it prefers EGL if that
            # library is loaded, even when it does not work.
            with _environment('MUJOCO_GL', backend):
                self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
        except BaseException:
            self._gl.free()
            raise
        # A renderer that is dropped without `close` releases its context as well, but not at the
        # end of the process: the driver may be gone by then.
        self._release = finalize(self, _release, self._gl, self._context)
        self._release.atexit = False
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(self._model, maxgeom=max(model.ngeom, 1))
        # No sky, haze, shadow or reflection. Back faces are drawn: the ray caster sees them.
        self._scene.flags[:] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 1
        self._scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = VISIBLE_GROUPS
        for group in (
            'sitegroup',
            'jointgroup',
            'tendongroup',
            'actuatorgroup',
            'flexgroup',
            'skingroup',
        ):
            getattr(self._option, group)[:] = 0
        self._category = mujoco.mjtCatBit.mjCAT_STATIC | mujoco.mjtCatBit.mjCAT_DYNAMIC
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        shape = (intrinsics.height, intrinsics.width)
        self._rect = mujoco.MjrRect(0, 0, intrinsics.width, intrinsics.height)
        self._rgb = np.empty((*shape, 3), np.uint8)
        self._buffer = np.empty(shape, np.float32)
        self._index = np.empty(shape, np.int32)
        self._geom_of: dict[str, np.ndarray] = {}

    def render(self, data: mujoco.MjData, camera: str) -> tuple[np.ndarray, np.ndarray]:
        """Render one camera, see `DepthRenderer.render`."""
        self._view.fixedcamid = self._cameras.select(camera)
        self._gl.make_current()
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._view, self._category, self._scene
        )
        geom_of = self._geom_of.get(camera)
        if geom_of is None or self._scene.ngeom != geom_of.size - 1:
            # Geom id by position in the scene; changes only when geoms appear or vanish.
            geom_of = self._geom_of[camera] = np.array(
                [-1] + [geom.objid for geom in self._scene.geoms[: self._scene.ngeom]], np.int32
            )
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(self._rgb, self._buffer, self._rect, self._context)
        # The image is upside down. A pixel's colour is 1 + its geom's position in the scene, with
        # red as the lowest byte; 0 is background.
        rgb, index = self._rgb[::-1], self._index
        np.copyto(index, rgb[..., 0])
        if geom_of.size > 256:
            index += rgb[..., 1] * np.int32(1 << 8)
            index += rgb[..., 2] * np.int32(1 << 16)
        geom_id = geom_of[index]
        # Reversed depth buffer b: 1 at the near plane, 0 at the far plane, linear in 1 / z.
        near, far = clip_planes(self._model)
        depth = self._buffer[::-1] * np.float32((far - near) / (near * far))
        depth += np.float32(1.0 / far)
        np.reciprocal(depth, out=depth)
        depth[geom_id < 0] = np.nan
        return depth, geom_id

    def close(self) -> None:
        """Release the graphics context."""
        self._release()
        self._gl = None


def _release(gl: Any, context: mujoco.MjrContext) -> None:
    # MuJoCo frees buffers by their numbers in the context that is current, which may be another
    # renderer's with buffers of the same numbers.
    gl.make_current()
    context.free()
    gl.free()


@contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    """Set an environment variable inside a block."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _gl_context(backend: str, width: int, height: int) -> Any:
    """
    Create an off-screen OpenGL context.

    PyOpenGL chooses its platform when it is first imported. If that was another one (perhaps one
    that failed), its modules are removed so that they are imported again. Contexts in use keep
    their modules.
    """
    loaded = sys.modules.get('OpenGL.platform')
    bound = getattr(getattr(loaded, 'PLATFORM', None), '__module__', '')
    if loaded is None or not bound.endswith(f'.{backend}'):
        for name in list(sys.modules):
            if name.split('.')[0] == 'OpenGL' or name in (
                'mujoco.egl',
                'mujoco.osmesa',
                'mujoco.egl.egl_ext',
            ):
                del sys.modules[name]
    with _environment('PYOPENGL_PLATFORM', backend):
        return importlib.import_module(f'mujoco.{backend}').GLContext(width, height)

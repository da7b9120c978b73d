"""Exact depth and surface ids from a MuJoCo model's cameras, with or without OpenGL."""

from collections.abc import Iterator
from contextlib import contextmanager
import copy
import importlib
import os
from pathlib import Path
import sys
from typing import Any, Protocol

from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.visibility import pixel_directions, unseen_geoms
import mujoco
import numpy as np

BACKENDS = ('auto', 'egl', 'osmesa', 'ray')
# Geom groups that are seen, as in MuJoCo's viewer: 0 to 2. By convention 3 and up hold collision
# shapes that stand inside the visible ones.
VISIBLE_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
_INVISIBLE = 5
# OpenGL would draw an infinite plane as thousands of squares: it gets one with sides of this
# many metres.
_PLANE_SIZE = 1000.0

# The colour of a geom that leaves it to its material, by MuJoCo's rule.
_NO_COLOUR = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
# What each OpenGL backend needs, for the message when it does not work.
_NEEDS = {
    'egl': 'libEGL with a driver (Debian: libegl1 libgl1-mesa-dri)',
    'osmesa': 'libOSMesa (Debian: libosmesa6)',
}


class DepthRenderer(Protocol):
    """
    What `open_renderer` returns.

    Attributes
    ----------
    backend : str
        ``egl``, ``osmesa`` or ``ray``.
    reasons : tuple of str
        Why each better backend was passed over; empty when there is nothing to say.

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
            (H, W) float32, metres along the optical axis; NaN where nothing is hit before the
            far plane.
        geom_id : np.ndarray
            (H, W) int32, the geom that is seen, -1 for nothing.

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
    Open the best renderer there is.

    What of the robot a camera can never see (`unseen_geoms`) is left out of its pictures.
    An OpenGL renderer belongs to the thread that opened it, and should be closed there. It draws
    round shapes with facets (``visual/quality`` in the model), so its depth is off by up to 0.6 %
    of their radius there; the ray caster's is exact. An object that reaches nearer than the near
    plane is seen through by OpenGL, while the ray caster sees nothing there.

    Parameters
    ----------
    model : mujoco.MjModel
        From `flexx2_sim_ros.robots.model.build_model`; copied: later changes to it are not seen,
        other than through the states of it that are rendered.
    intrinsics : Intrinsics
        The ones the model was built with.
    backend : str
        ``egl``, ``osmesa``, ``ray`` (``mj_multiRay``; no graphics library needed), or ``auto``:
        the first of them that works. No environment variable has a say.

    Returns
    -------
    DepthRenderer

    Raises
    ------
    InputError
        For an unknown backend, or when the one that was asked for does not work here.

    """
    if backend not in BACKENDS:
        raise InputError(f'backend: must be one of {", ".join(BACKENDS)}, got {backend!r}')
    if backend == 'ray':
        return _RayRenderer(model, intrinsics, ())
    reasons: list[str] = []
    for name in ('egl', 'osmesa') if backend == 'auto' else (backend,):
        try:
            return _GlRenderer(model, intrinsics, name, tuple(reasons))
        except Exception as error:  # a missing or broken driver raises anything
            reasons.append(
                f'{name} does not work here, it needs {_NEEDS[name]} '
                f'[{type(error).__name__}: {error}]'
            )
    if backend != 'auto':
        raise InputError(f'backend: must be one that works here, or auto, got {reasons[0]}')
    return _RayRenderer(model, intrinsics, tuple(reasons))


class _Cameras:
    """
    Camera ids by name, each checked once against the intrinsics.

    Attributes
    ----------
    model : mujoco.MjModel
        A copy, in which `select` leaves visible what one camera can see.

    """

    def __init__(self, model: mujoco.MjModel, intrinsics: Intrinsics) -> None:
        self.model = copy.copy(model)
        self._groups = model.geom_group.copy()
        self._intrinsics = intrinsics
        self._found: dict[str, tuple[int, np.ndarray]] = {}

    def select(self, name: str) -> int:
        if name not in self._found:
            index = self._find(name)
            hidden = unseen_geoms(self.model, index, self._intrinsics)
            self._found[name] = index, np.where(hidden, _INVISIBLE, self._groups)
        index, self.model.geom_group[:] = self._found[name]
        return index

    def _find(self, name: str) -> int:
        model, wanted = self.model, self._intrinsics
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if index < 0:
            names = ', '.join(model.cam(i).name for i in range(model.ncam))
            raise InputError(f'camera: must be one of {names or "none: no camera"}, got {name!r}')
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


def _clip_planes(model: mujoco.MjModel) -> tuple[float, float]:
    extent = model.stat.extent
    return float(model.vis.map.znear * extent), float(model.vis.map.zfar * extent)


class _GlRenderer:
    """One OpenGL pass that draws every geom in the colour of its id, and its depth buffer."""

    def __init__(
        self, model: mujoco.MjModel, intrinsics: Intrinsics, backend: str, reasons: tuple[str, ...]
    ) -> None:
        self.backend = backend
        self.reasons = reasons
        self._cameras = _Cameras(model, intrinsics)
        self._model = self._cameras.model
        planes = self._model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        infinite = planes & (self._model.geom_size[:, :2].min(axis=1) <= 0)
        self._model.geom_size[infinite] = _PLANE_SIZE
        self._gl = _gl_context(backend, intrinsics.width, intrinsics.height)
        try:
            self._gl.make_current()
            # MuJoCo looks OpenGL up once a process and would prefer EGL's when that library is
            # loaded, even where it did not work; in this variable it takes a hint.
            with _environment('MUJOCO_GL', backend):
                self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
        except BaseException:
            self._gl.free()
            raise
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(self._model, maxgeom=max(model.ngeom, 1))
        # No sky, haze, shadow or reflection. Back faces are drawn: the ray caster sees them too.
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
        self._view.fixedcamid = self._cameras.select(camera)
        self._gl.make_current()
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._view, self._category, self._scene
        )
        geom_of = self._geom_of.get(camera)
        if geom_of is None or self._scene.ngeom != geom_of.size - 1:
            # Position in the scene to geom id: changes only when geoms appear or vanish.
            geom_of = self._geom_of[camera] = np.array(
                [-1] + [geom.objid for geom in self._scene.geoms[: self._scene.ngeom]], np.int32
            )
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(self._rgb, self._buffer, self._rect, self._context)
        # The image is upside down. A pixel's colour is 1 + its geom's position in the scene, red
        # lowest; 0 is nothing.
        rgb, index = self._rgb[::-1], self._index
        np.copyto(index, rgb[..., 0])
        if geom_of.size > 256:
            index += rgb[..., 1] * np.int32(1 << 8)
            index += rgb[..., 2] * np.int32(1 << 16)
        geom_id = geom_of[index]
        # Reversed depth buffer b: 1 at the near plane, 0 at the far plane, linear in 1 / z.
        near, far = _clip_planes(self._model)
        depth = self._buffer[::-1] * np.float32((far - near) / (near * far))
        depth += np.float32(1.0 / far)
        np.reciprocal(depth, out=depth)
        depth[geom_id < 0] = np.nan
        return depth, geom_id

    def close(self) -> None:
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None


@contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    """Set an environment variable for the length of a block."""
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

    PyOpenGL binds itself to one platform when it is first imported. When that was another one
    (perhaps one that failed), its modules are dropped so that it starts afresh; contexts that
    are in use keep the modules they hold.
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


class _RayRenderer:
    """One exact ray a pixel."""

    backend = 'ray'

    def __init__(
        self, model: mujoco.MjModel, intrinsics: Intrinsics, reasons: tuple[str, ...]
    ) -> None:
        self.reasons = reasons
        self._cameras = _Cameras(model, intrinsics)
        self._model = self._cameras.model
        self._shape = (intrinsics.height, intrinsics.width)
        rays = pixel_directions(intrinsics).reshape(-1, 3)
        length = np.linalg.norm(rays, axis=1)
        self._rays = rays / length[:, None]
        self._cosine = 1.0 / length
        self._world = np.empty_like(self._rays)
        self._distance = np.empty(length.size)
        self._geom_id = np.empty(length.size, np.int32)
        # Older versions of MuJoCo have no argument for normals.
        doc = mujoco.mj_multiRay.__doc__ or ''
        self._extra: dict[str, Any] = {'normal': None} if 'normal' in doc else {}

    def render(self, data: mujoco.MjData, camera: str) -> tuple[np.ndarray, np.ndarray]:
        index = self._cameras.select(camera)
        near, far = _clip_planes(self._model)
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
            nray=self._geom_id.size,
            cutoff=far / self._cosine.min(),
            **self._extra,
        )
        depth = (self._distance * self._cosine).astype(np.float32)
        missed = ~((depth > near) & (depth < far))
        depth[missed] = np.nan
        geom_id = np.where(missed, np.int32(-1), self._geom_id)
        return depth.reshape(self._shape), geom_id.reshape(self._shape)

    def close(self) -> None:
        """Nothing to release."""


def load_materials(path: str | Path | None = None) -> dict[str, float]:
    """
    Read the reflectivities of named materials.

    Parameters
    ----------
    path : str or pathlib.Path, optional
        A file like ``config/materials.yaml``, which is the default.

    Returns
    -------
    dict of str to float
        Diffuse reflectivity at 940 nm, 0 to 1, by material name.

    Raises
    ------
    InputError
        When the file cannot be read or an entry is not a number from 0 to 1.

    """
    path = config_dir() / 'materials.yaml' if path is None else Path(path)
    entries = read_section(path, 'materials', dict)
    table = {}
    for name, entry in entries.items():
        value = entry.get('reflectivity') if isinstance(entry, dict) else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 1:
            raise InputError(
                f'{path}: materials.{name}.reflectivity: must be a number from 0 to 1, '
                f'got {value!r}'
            )
        table[str(name)] = float(value)
    return table


def reflectivity_table(
    model: mujoco.MjModel, materials: dict[str, float] | None = None
) -> np.ndarray:
    """
    Return every geom's reflectivity at 940 nm, to be indexed with a renderer's ``geom_id``.

    Parameters
    ----------
    model : mujoco.MjModel
        Any model. A material's name counts after its last ``/``.
    materials : dict of str to float, optional
        Reflectivity by material name; default `load_materials()`.

    Returns
    -------
    np.ndarray
        (ngeom + 1,) float32, 0 to 1. A geom without a listed material takes the Rec. 709
        luminance of its colour. The last entry, which id -1 picks, is 0.

    """
    materials = load_materials() if materials is None else materials
    table = np.zeros(model.ngeom + 1, np.float32)
    for geom in range(model.ngeom):
        material = model.geom_matid[geom]
        rgba = model.geom_rgba[geom]
        name = ''
        if material >= 0:
            name = model.mat(material).name.rsplit('/', 1)[-1]
            if np.array_equal(rgba, _NO_COLOUR):
                rgba = model.mat_rgba[material]
        table[geom] = materials.get(name, float(rgba[:3] @ (0.2126, 0.7152, 0.0722)))
    return table.clip(0.0, 1.0)

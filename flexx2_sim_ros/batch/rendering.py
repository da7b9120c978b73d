"""Depth images of many states of one model: with mujoco-warp, or with MuJoCo in threads."""

from concurrent.futures import ThreadPoolExecutor
import copy
import importlib
import importlib.util
import os
from typing import Any, Protocol

from flexx2_sim_ros.batch.frame import OPTIONS
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.rendering.renderer import open_renderer
import mujoco
import numpy as np
import warp as wp

wp.set_module_options(OPTIONS)

BACKENDS = ('auto', 'mujoco-warp', 'egl', 'osmesa', 'ray')


@wp.kernel
def unpack(
    images: wp.array2d(dtype=wp.float32), offset: wp.int32, out: wp.array3d(dtype=wp.float32)
):
    """Copy one camera's images from those of all cameras of an environment."""
    n, v, u = wp.tid()
    out[n, v, u] = images[n, offset + v * out.shape[2] + u]


class BatchRenderer(Protocol):
    """What `open_batch_renderer` returns; `backend` is one of `BACKENDS`, not ``auto``."""

    backend: str

    def render(self, qpos: np.ndarray) -> list[wp.array]:
        """
        Render every camera in every environment, with the (N, nq) states `qpos`.

        For each camera: (N, H, W) float32, metres along the optical axis, 0 or NaN where nothing
        is hit; valid until the next call.
        """


def open_batch_renderer(
    model: mujoco.MjModel,
    cameras: tuple[str, ...],
    intrinsics: Intrinsics,
    num_envs: int,
    device: Any,
    backend: str = 'auto',
) -> BatchRenderer:
    """
    Open the best renderer there is, with images on `device`.

    The robot itself is not drawn, as if its own pixels had been taken out. `model` is from
    `build_model`, with the same `intrinsics`. `backend` is ``mujoco-warp`` (renders on `device`),
    ``egl``, ``osmesa`` or ``ray`` (MuJoCo on the CPU), or ``auto``: the first on a GPU where it is
    installed, else the best of the others. Raises InputError for an unknown backend, or one that
    does not work here.
    """
    if backend not in BACKENDS:
        raise InputError(f'renderer: must be one of {", ".join(BACKENDS)}, got {backend!r}')
    installed = importlib.util.find_spec('mujoco_warp') is not None
    if backend == 'mujoco-warp' and not installed:
        raise InputError(
            'renderer: mujoco-warp is not installed: pip install mujoco-warp, or choose '
            'another renderer'
        )
    scene = copy.copy(model)
    # The robot is what hangs from the same body as its cameras.
    eye = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, cameras[0])
    root = model.body_rootid[model.cam_bodyid[eye]]
    scene.geom_group[model.body_rootid[model.geom_bodyid] == root] = 5
    if backend == 'mujoco-warp' or (backend == 'auto' and installed and device.is_cuda):
        return _OnDevice(scene, cameras, intrinsics, num_envs, device)
    return _InThreads(scene, cameras, intrinsics, num_envs, device, backend)


class _InThreads:
    """MuJoCo's own renderers: rays in as many threads as there are cores, OpenGL in one."""

    def __init__(
        self,
        model: mujoco.MjModel,
        cameras: tuple[str, ...],
        intrinsics: Intrinsics,
        num_envs: int,
        device: Any,
        backend: str,
    ) -> None:
        self._model, self._cameras = model, cameras
        first = open_renderer(model, intrinsics, backend)
        self.backend = first.backend
        cores = len(os.sched_getaffinity(0)) if self.backend == 'ray' else 1
        self._renderers = [first] + [
            open_renderer(model, intrinsics, self.backend) for _ in range(cores - 1)
        ]
        self._data = [mujoco.MjData(model) for _ in self._renderers]
        shape = (num_envs, intrinsics.height, intrinsics.width)
        self._images = [np.empty(shape, np.float32) for _ in cameras]
        self._on_device = [wp.array(image, device=device, copy=False) for image in self._images]

    def render(self, qpos: np.ndarray) -> list[wp.array]:
        def some(worker: int) -> None:
            data = self._data[worker]
            for env in range(worker, len(qpos), len(self._renderers)):
                data.qpos[:] = qpos[env]
                mujoco.mj_forward(self._model, data)
                for camera, image in zip(self._cameras, self._images, strict=True):
                    image[env] = self._renderers[worker].render(data, camera)[0]

        if len(self._renderers) == 1:
            some(0)  # OpenGL belongs to the thread that opened it.
        else:
            with ThreadPoolExecutor(len(self._renderers)) as pool:
                list(pool.map(some, range(len(self._renderers))))
        for on_device, image in zip(self._on_device, self._images, strict=True):
            if on_device.device.is_cuda:
                on_device.assign(image)
        return self._on_device


class _OnDevice:
    """mujoco-warp's batch renderer."""

    backend = 'mujoco-warp'

    def __init__(
        self,
        model: mujoco.MjModel,
        cameras: tuple[str, ...],
        intrinsics: Intrinsics,
        num_envs: int,
        device: Any,
    ) -> None:
        self._mjw = mjw = importlib.import_module('mujoco_warp')
        self._shape = (num_envs, intrinsics.height, intrinsics.width)
        self._device = device
        with wp.ScopedDevice(device):
            self._model = mjw.put_model(model)
            self._data = mjw.make_data(model, nworld=num_envs)
            self._context = mjw.create_render_context(
                model,
                nworld=num_envs,
                cam_res=(intrinsics.width, intrinsics.height),
                render_rgb=False,
                render_depth=True,
                use_textures=False,
                cam_active=list(cameras),
            )
            self._offsets = self._context.depth_adr.numpy().tolist()
            self._images = [wp.empty(self._shape, dtype=wp.float32) for _ in cameras]

    def render(self, qpos: np.ndarray) -> list[wp.array]:
        mjw = self._mjw
        with wp.ScopedDevice(self._device):
            self._data.qpos.assign(qpos.astype(np.float32))
            mjw.kinematics(self._model, self._data)
            mjw.com_pos(self._model, self._data)
            mjw.camlight(self._model, self._data)
            mjw.refit_bvh(self._model, self._data, self._context)
            mjw.render(self._model, self._data, self._context)
            for index, image in enumerate(self._images):
                wp.launch(
                    unpack, image.shape, [self._context.depth_data, self._offsets[index], image]
                )
        return self._images

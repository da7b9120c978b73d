"""Exact depth and reflectivity of terrain, as a robot's cameras would see it, with MuJoCo."""

from collections.abc import Sequence

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.pinholes import add_camera, check_view, FAR, NEAR, set_view
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.robots.robot import CameraMount
from flexx2_sim_ros.walking.terrain import Terrain
import mujoco
import numpy as np


class TerrainRenderer:
    """
    Cameras over blocks, of half sizes (B, 3) metres, that are moved for each walk.

    The robot itself is not drawn: its cameras do not see it while it stands. ``lens`` is that of
    each camera; the principal point in the middle, no distortion. ``mounts`` are the cameras on
    the trunk.
    """

    def __init__(self, half: np.ndarray, lens: Intrinsics, mounts: Sequence[CameraMount]) -> None:
        """Build the model and open a renderer."""
        check_view(lens, NEAR, FAR)
        spec = mujoco.MjSpec()
        for size in half:
            body = spec.worldbody.add_body(mocap=True)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size)
        trunk = spec.worldbody.add_body(mocap=True)
        for mount in mounts:
            add_camera(trunk, mount.name, mount.position, mount.rotation, lens)
        set_view(spec, lens, NEAR, FAR)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._renderer = open_renderer(self._model, lens)
        self._names = [mount.name for mount in mounts]

    def place(self, terrain: Terrain, walk: int) -> None:
        """Put the blocks where one walk of a terrain has them."""
        data, blocks = self._data, len(terrain.half)
        data.mocap_pos[:blocks, :2] = terrain.centre[walk]
        data.mocap_pos[:blocks, 2] = terrain.top[walk] - terrain.half[:, 2]
        turn = terrain.yaw[walk] / 2
        data.mocap_quat[:blocks] = 0.0
        data.mocap_quat[:blocks, 0], data.mocap_quat[:blocks, 3] = np.cos(turn), np.sin(turn)
        self._reflectivity = np.append(terrain.reflectivity[walk], 0.0).astype(np.float32)

    def look(self, position: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Render all cameras, with the trunk at a position (3,) and rotation (3, 3).

        Returned are (C, H, W) float32: depth, metres along the optical axis, NaN where there is no
        return; and reflectivity.
        """
        data = self._data
        data.mocap_pos[-1] = position
        mujoco.mju_mat2Quat(data.mocap_quat[-1], rotation.ravel())
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        # The id of a geom is the number of its block; -1, no return, is the last reflectivity.
        images = [self._renderer.render(data, name) for name in self._names]
        return (
            np.stack([depth for depth, _ in images]),
            np.stack([self._reflectivity[geom] for _, geom in images]),
        )

    def close(self) -> None:
        """Release the graphics context; `look` cannot be called after it."""
        self._renderer.close()


def render(
    terrain: Terrain,
    lens: Intrinsics,
    mounts: Sequence[CameraMount],
    position: np.ndarray,
    rotation: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Render what the cameras of N walks see in L looks.

    The trunks are at positions (L, N, 3) and rotations (L, N, 3, 3), with C cameras, ``mounts``,
    on each. The ``lens`` has the principal point in the middle and no distortion. Returned are (C,
    L, N, H, W) float32: depth, metres along the optical axis, NaN where there is no return; and
    reflectivity.
    """
    looks, walks = position.shape[:2]
    shape = (len(mounts), looks, walks, lens.height, lens.width)
    depth, reflectivity = np.empty(shape, np.float32), np.empty(shape, np.float32)
    renderer = TerrainRenderer(terrain.half, lens, mounts)
    try:
        for i in range(walks):
            renderer.place(terrain, i)
            for k in range(looks):
                depth[:, k, i], reflectivity[:, k, i] = renderer.look(
                    position[k, i], rotation[k, i]
                )
    finally:
        renderer.close()
    return depth, reflectivity

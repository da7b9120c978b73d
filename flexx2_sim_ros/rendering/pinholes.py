"""Add pinhole cameras to a MuJoCo model."""

from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import check_clipping_planes
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.scenes import load_scene, PREFIX
import mujoco
import numpy as np

NEAR, FAR = 0.02, 20.0  # clipping planes, metres


def check_view(intrinsics: Intrinsics, near: float, far: float) -> None:
    """Refuse clipping planes and intrinsics that the renderer cannot draw."""
    check_clipping_planes(near, far)
    centre = ((intrinsics.width - 1) / 2, (intrinsics.height - 1) / 2)
    if (intrinsics.cx, intrinsics.cy) != centre or any(intrinsics.distortion):
        raise InputError(
            f'intrinsics: must have principal point {centre} and no distortion (the renderer '
            f'is a pinhole), got ({intrinsics.cx}, {intrinsics.cy}) and '
            f'{intrinsics.distortion}'
        )


def add_camera(
    body: Any,
    name: str,
    position: tuple[float, float, float],
    rotation: np.ndarray,
    intrinsics: Intrinsics,
) -> None:
    """
    Attach a camera to a body.

    Parameters
    ----------
    body : mujoco.MjsBody
        A body of the specification.
    name : str
        The camera's name.
    position : tuple of float
        The lens in the body's frame, metres.
    rotation : numpy.ndarray
        (3, 3) float64: the optical axes x right, y down, z forward in the body's frame.
    intrinsics : Intrinsics
        With the principal point in the middle and no distortion.

    """
    quat = np.empty(4)
    # MuJoCo's cameras look along -z with y up.
    mujoco.mju_mat2Quat(quat, (rotation * [1.0, -1.0, -1.0]).ravel())
    size = [intrinsics.width, intrinsics.height]
    body.add_camera(
        name=name,
        pos=position,
        quat=quat,
        resolution=size,
        focal_pixel=[intrinsics.fx, intrinsics.fy],
        # Any pixel pitch gives the same image. The principal point is an offset from the middle.
        sensor_size=[1e-3 * size[0], 1e-3 * size[1]],
        principal_pixel=[0.0, 0.0],
    )


def set_view(spec: mujoco.MjSpec, intrinsics: Intrinsics, near: float, far: float) -> None:
    """Set the clipping planes (metres) and the size of the off-screen buffer."""
    spec.stat.extent = 1.0  # MuJoCo multiplies znear and zfar by it
    spec.visual.map.znear, spec.visual.map.zfar = near, far
    buffer = spec.visual.global_
    buffer.offwidth = max(buffer.offwidth, intrinsics.width)
    buffer.offheight = max(buffer.offheight, intrinsics.height)
    quality = spec.visual.quality
    quality.offsamples = quality.shadowsize = 0
    quality.numquads = 1  # flat faces need no subdivision for depth


def board_model(intrinsics: Intrinsics, camera: str = 'camera') -> mujoco.MjModel:
    """
    Return the scene ``board`` with one camera in front of it, without a robot.

    The camera looks along +x, 1 m above the ground; its name is for `place_board`. ``intrinsics``
    have the principal point in the middle and no distortion; raises InputError when they cannot be
    rendered.
    """
    check_view(intrinsics, NEAR, FAR)
    spec, (scene, _) = mujoco.MjSpec(), load_scene('board')
    spec.attach(scene, prefix=PREFIX, frame=spec.worldbody.add_frame())
    # x right, y down, z forward for a camera that looks along x, with z up.
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    add_camera(spec.worldbody, camera, (0.0, 0.0, 1.0), axes, intrinsics)
    set_view(spec, intrinsics, NEAR, FAR)
    return spec.compile()

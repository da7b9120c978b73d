"""Clean images of another camera, looked up at the pixels of the recorded one."""

from collections.abc import Callable
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.camera_info import decode_camera_info
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np


def view_of(
    camera: Intrinsics, clean_info: Any, radial: bool = False, rectified: bool = False
) -> Reprojection | None:
    """
    Return how the recorded camera looks through the clean images of a simulator.

    Parameters
    ----------
    camera : Intrinsics
        The recorded camera.
    clean_info : message
        The ``sensor_msgs/CameraInfo`` of the clean images.
    radial : bool
        Whether the clean images hold distances along the ray instead of along the axis.
    rectified : bool
        Whether the clean images are rectified.

    Returns
    -------
    Reprojection or None
        None where both have the same pixels, or where the message describes no camera.

    """
    try:
        source = decode_camera_info(clean_info, rectified=rectified)
    except InputError:
        return None
    if camera == source and not radial:
        return None
    view = Reprojection(camera, source, radial)
    return None if view.identical and not radial else view


def looked_up(
    decoder: Callable[[bytes], np.ndarray], view: Reprojection, depth: bool
) -> Callable[[bytes], np.ndarray]:
    """
    Return a decoder of the images as the recorded camera sees them.

    Parameters
    ----------
    decoder : callable
        Returns a clean image of a message, (H, W). One that is not of the source's size is left
        as it is.
    view : Reprojection
        As from `view_of`.
    depth : bool
        Whether it is depth, metres; else reflectivity.

    Returns
    -------
    callable
        The image at the camera's pixels, float32; NaN where the clean images do not reach.

    """

    def look(data: bytes) -> np.ndarray:
        image = decoder(data)
        if image.shape != (view.source.height, view.source.width):
            return image
        image = image.astype(np.float32, copy=False)
        seen = view.depth(image) if depth else view.reflectivity(image)
        return np.where(view.outside, np.float32(np.nan), seen)

    return look

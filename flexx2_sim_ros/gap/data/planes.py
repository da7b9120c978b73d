"""How depth changes with the parameters of planes that are not known exactly."""

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.data.unknown import nearest
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.recording.truth import plane_axes
import numpy as np

# Steps of a plane's three parameters for finite differences: metres, radians.
PLANE_STEPS = np.array(GROUND_TRUTH.plane_steps)


def plane_shifts(
    clean: np.ndarray, plane: np.ndarray, lens: Intrinsics, count: int, known: np.ndarray
) -> np.ndarray:
    """
    Return the derivatives of depth with respect to the parameters of planes, (3 P, H, W) float32.

    Each plane has three parameters: an offset along its normal in metres, and right-handed turns
    about its first and second in-plane axis in radians. The normal points away from the camera, so
    a positive offset moves the plane away. The axes go through the mean of the plane's points. The
    first axis is the image's x axis projected onto the plane (the y axis if the plane faces along
    x). The second is the cross product of normal and first axis. Values are metres of depth per
    metre or radian, 0 outside of the plane.

    `clean` is (H, W) metres, NaN for no return, unknown pixels filled; `plane` (H, W) uint8: 0 for
    no plane, k for the k-th of `count`; `known` (H, W) bool. Unknown pixels move with the plane of
    the nearest known one.
    """
    out = np.zeros((3 * count, *clean.shape), np.float32)
    rays = np.stack([*pixel_rays(lens), np.ones(clean.shape)], axis=-1)
    clean = np.where(np.isfinite(rays).all(axis=-1), clean, np.float32(np.nan))
    wider = nearest(plane, known)
    for k in range(count):
        own = (plane == k + 1) & known & np.isfinite(clean)
        if own.sum() < 3:
            continue
        points = rays[own] * clean[own][:, None]
        centre = points.mean(axis=0)
        normal = np.linalg.eigh(np.cov((points - centre).T))[1][:, 0]
        normal *= 1.0 if normal @ centre >= 0 else -1.0
        first, second = plane_axes(normal)
        moving = (wider == k + 1) & np.isfinite(clean)
        arm = rays[moving] * clean[moving][:, None] - centre
        facing = rays[moving] @ normal
        along = np.stack([np.ones(len(arm)), arm @ second, -(arm @ first)])
        out[3 * k : 3 * k + 3, moving] = np.where(
            facing > GROUND_TRUTH.least_cosine, along / facing, 0
        )
    return out

"""Planes whose place is known within bounds only: how depth changes with their parameters."""

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
    Return what the parameters of planes change of depth.

    Each plane has three: an offset along its normal, in metres; the normal points away from the
    camera, so that a positive one is farther; a turn about its first in-plane axis and one about
    its second, in radians, right-handed. The axes go through the mean of the plane's points. The
    first is the image's x axis projected onto the plane (the y axis, where the plane faces along
    x); the second is normal x first.

    Parameters
    ----------
    clean : numpy.ndarray
        (H, W) metres, NaN for no return; something that stands in where unknown.
    plane : numpy.ndarray
        (H, W) uint8: 0 for no plane, k for the k-th.
    lens : Intrinsics
        With its distortion.
    count : int
        How many planes there are.
    known : numpy.ndarray
        (H, W) bool. Unknown pixels move with the plane of the nearest known one.

    Returns
    -------
    numpy.ndarray
        (3 P, H, W) float32, metres of depth a metre or radian, 0 outside of the plane.

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

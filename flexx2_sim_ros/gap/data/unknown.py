"""What the ground truth does not know: pixels, which are never compared, and where planes are."""

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.physics.nearest import nearest_pixels
from flexx2_sim_ros.physics.surface import NEAREST, PAD, tangents
from flexx2_sim_ros.profiles.sensor import Sensor
from flexx2_sim_ros.recording.truth import plane_axes
import numpy as np
from scipy import ndimage

# Steps of a plane's three parameters for finite differences: metres, radians.
PLANE_STEPS = np.array(GROUND_TRUTH.plane_steps)


def fill(clean: np.ndarray, known: np.ndarray, sensor: Sensor) -> np.ndarray:
    """
    Fill unknown pixels: continue the nearest known surface, or its absence.

    `clean` is (H, W) or (T, H, W) float32 metres, NaN for no return; `known` likewise, bool. Known
    pixels are unchanged.
    """
    if clean.ndim == 2:
        return _fill(clean, known, sensor)
    masks = np.broadcast_to(known, clean.shape)
    return np.stack([_fill(*one, sensor) for one in zip(clean, masks, strict=True)])


def nearest(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return (..., H, W) values; an unknown pixel gets the value of the nearest known pixel."""
    if values.ndim == 3:
        masks = np.broadcast_to(known, values.shape)
        return np.stack([nearest(*one) for one in zip(values, masks, strict=True)])
    if known.all() or not known.any():
        return values
    return np.asarray(values[nearest_pixels(known)])


def _fill(clean: np.ndarray, known: np.ndarray, sensor: Sensor) -> np.ndarray:
    if known.all() or not known.any():
        return clean
    seen = np.where(known, clean, np.float32(np.nan))
    inverse, across, down = tangents(seen, sensor)
    row, column = nearest_pixels(known)
    v, u = np.mgrid[: clean.shape[0], : clean.shape[1]]
    # The slope is not continued farther, because it comes from a few pixels at the border.
    reach = GROUND_TRUTH.continued
    here = inverse[PAD:-PAD, PAD:-PAD][row, column]
    step_x, step_y = (np.clip(n, -reach, reach) for n in (u - column, v - row))
    there = here + across[row, column] * step_x + down[row, column] * step_y
    low, high = GROUND_TRUTH.inverse_depths
    there = np.clip(there, low * here, high * here)
    with np.errstate(divide='ignore'):
        filled = np.where(there > NEAREST, 1 / there, np.nan)
    return np.where(known, clean, filled).astype(np.float32)


def judged(known: np.ndarray, near: int) -> np.ndarray:
    """
    Return the pixels that may be compared, (H, W) bool: known ones far enough from unknown ones.

    The 8 neighbours of each unknown pixel are left out. An unknown area that is at least 3 pixels
    wide may hide an object with a depth jump, so `near` pixels around it are left out: within this
    distance from a jump pixels do not count as surface. In images of a few pixels these margins
    would leave nothing; they shrink with the image.
    """
    if known.all():
        return known
    unknown = ~known
    wide = ndimage.binary_opening(
        unknown, np.ones((GROUND_TRUTH.narrow, GROUND_TRUTH.narrow), bool)
    )
    return np.asarray(
        ~(_grown(unknown, margin(1, known.shape)) | _grown(wide, margin(near, known.shape)))
    )


def margin(pixels: int, shape: tuple[int, ...]) -> int:
    """Return a margin of so many pixels, less of it in an image (..., H, W) of few pixels."""
    return int(pixels * min(1.0, min(shape[-2:]) / GROUND_TRUTH.whole_margins))


def _grown(mask: np.ndarray, reach: int) -> np.ndarray:
    square = np.ones((3, 3), bool)
    return ndimage.binary_dilation(mask, square, iterations=reach) if reach else mask


def away(known: np.ndarray, reach: int) -> np.ndarray:
    """Return the (H, W) pixels without an unknown pixel within ``reach`` pixels."""
    if known.all():
        return known
    return np.asarray(~_grown(~known, reach))


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

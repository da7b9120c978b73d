"""
Planes as a depth camera sees them.

A plane's inverse depth is an affine function of the pixel coordinates, whatever the focal length:
1/z = p + q u + r v. So planes are fitted without knowing the camera; only the incidence angle
needs its matrix. A lens that distorts bends them: it has to be known, and pixels go where a
pinhole camera of the same matrix would have them.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np
from scipy import ndimage

_REFINEMENTS = 3


def straighten(u: Any, v: Any, lens: Intrinsics | None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return where a pinhole camera would have the pixels (u, v), float64 of the same shape.

    They lie within the image. ``lens`` is None for a camera that does not distort. NaN where the
    distortion cannot be inverted.
    """
    u, v = np.asarray(u, np.float64), np.asarray(v, np.float64)
    if lens is None:
        return u, v
    places = np.stack([v.ravel(), u.ravel()])
    across, down = (
        ndimage.map_coordinates(image, places, order=1, mode='nearest')
        for image in _straight_pixels(lens)
    )
    return across.reshape(u.shape), down.reshape(u.shape)


@lru_cache(maxsize=8)
def _straight_pixels(lens: Intrinsics) -> np.ndarray:
    x, y = pixel_rays(lens)
    return np.stack([x * lens.fx + lens.cx, y * lens.fy + lens.cy])


@dataclass(frozen=True)
class Plane:
    """
    A plane in an image: inverse depth at pixel (u, v) is ``p + q u + r v``, 1/m.

    ``lens`` is the camera, if it distorts: (u, v) are then a pinhole camera's.
    """

    p: float
    q: float
    r: float
    lens: Intrinsics | None = None

    def depth(self, u: Any, v: Any) -> np.ndarray:
        """Return the depth along the optical axis at pixels, metres; NaN where there is none."""
        u, v = straighten(u, v, self.lens)
        inverse = self.p + self.q * u + self.r * v
        return 1.0 / np.where(inverse > 0, inverse, np.nan)

    def incidence(self, u: Any, v: Any, K: np.ndarray) -> np.ndarray:  # noqa: N803
        """
        Return the angle between the ray of pixels and the plane's normal, radians, 0 to pi/2.

        ``K`` is the (3, 3) camera matrix.
        """
        (fx, _, cx), (_, fy, cy), _ = K
        normal = np.array([fx * self.q, fy * self.r, self.p + self.q * cx + self.r * cy])
        u, v = straighten(u, v, self.lens)
        x, y = (u - cx) / fx, (v - cy) / fy
        along = normal[0] * x + normal[1] * y + normal[2]
        lengths = np.linalg.norm(normal) * np.sqrt(1.0 + x**2 + y**2)
        return np.arccos(np.clip(np.abs(along) / lengths, 0.0, 1.0))


def fit_plane(
    u: np.ndarray, v: np.ndarray, depth: np.ndarray, lens: Intrinsics | None = None
) -> Plane:
    """
    Fit a plane by least squares in depth.

    There are three or more pixels that are not in line, and their depths in metres, all finite.
    The pixels are to be where the distortion of ``lens`` can be inverted.
    """
    u, v = straighten(u, v, lens)
    # About the middle, where the normal equations are well conditioned.
    u0, v0 = float(np.mean(u)), float(np.mean(v))
    design = np.stack([np.ones(len(u)), u - u0, v - v0])
    depth = depth.astype(np.float64)
    # First in inverse depth, where an error dz of depth is one of dz / z^2. That is drawn to the
    # nearer pixels by sigma^2 / z; Gauss-Newton steps in depth itself are not.
    weighted = design * depth**4
    solution = np.linalg.lstsq(weighted @ design.T, weighted @ (1.0 / depth), rcond=None)[0]
    for _ in range(_REFINEMENTS):
        fitted = np.maximum(solution @ design, 1e-6)
        weighted = design / fitted**4
        error = (1.0 / fitted - depth) * fitted**2
        solution = solution + np.linalg.lstsq(weighted @ design.T, weighted @ error, rcond=None)[0]
    p, q, r = solution
    return Plane(float(p - q * u0 - r * v0), float(q), float(r), lens)


def ransac_plane(
    u: np.ndarray,
    v: np.ndarray,
    depth: np.ndarray,
    tolerance: float,
    lens: Intrinsics | None = None,
) -> Plane:
    """
    Fit a plane to what may be several surfaces: the one with the most pixels.

    Depths of the pixels are in metres, all finite. ``tolerance`` is how far from the plane its
    pixels may lie, metres. The result is the same every time.
    """
    # Imported here: it takes a second, which `flexx2 --help` need not wait for.
    from sklearn.linear_model import LinearRegression, RANSACRegressor

    # The tolerance is one of depth; at the middle's depth it is this much of inverse depth.
    threshold = tolerance / float(np.median(depth)) ** 2
    across, down = straighten(u, v, lens)
    scale = max(np.ptp(across), np.ptp(down), 1.0)
    design = np.stack([(across - across.mean()) / scale, (down - down.mean()) / scale], axis=1)
    search = RANSACRegressor(
        LinearRegression(),
        residual_threshold=threshold,
        random_state=0,
        max_trials=200,
        stop_probability=0.9999,
    )
    search.fit(design, 1.0 / depth)
    inside = search.inlier_mask_
    return fit_plane(u[inside], v[inside], depth[inside], lens)

"""
From any depth image to the camera's own pixels.

Each output pixel's ray is looked up in the input. It takes the tangent plane of the input pixel
it falls into (in inverse depth, where planes are exact), never a mixture of two surfaces.
"""

from functools import cached_property, lru_cache
import math
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.formulas import on_images, surfaces
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.physics.surface import PAD, tangents
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.sensor import DEFAULT_SENSOR, Sensor
import numpy as np

_ITERATIONS = {5: 30, 8: 100}  # by the number of coefficients: rational lenses are wide
_TOLERANCE_PX = 0.01
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_NAN = np.float32(np.nan)

_beside = compiled(surfaces.beside)


def pixel_rays(camera: Intrinsics) -> np.ndarray:
    """
    Return the ray of every pixel, distortion taken off, (2, H, W) float64.

    They are x/z and y/z in the optical frame; NaN where the distortion cannot be inverted.
    """
    return _pixel_rays(camera).copy()


@lru_cache(maxsize=16)  # Inverting the distortion takes longer than all that is done with it.
def _pixel_rays(camera: Intrinsics) -> np.ndarray:
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    target_x = (u - camera.cx) / camera.fx
    target_y = (v - camera.cy) / camera.fy
    if not any(camera.distortion):
        return np.stack([target_x, target_y])
    x, y = target_x.copy(), target_y.copy()
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
        for _ in range(_ITERATIONS[len(camera.distortion)]):
            distorted_x, distorted_y = _distort(x, y, camera.distortion)
            x += target_x - distorted_x
            y += target_y - distorted_y
        distorted_x, distorted_y = _distort(x, y, camera.distortion)
        error = np.hypot(
            (distorted_x - target_x) * camera.fx, (distorted_y - target_y) * camera.fy
        )
    rays = np.stack([x, y])
    rays[:, ~(error < _TOLERANCE_PX)] = np.nan
    return rays


def centred(camera: Intrinsics) -> Intrinsics:
    """
    Return the plain pinhole to render for a camera: itself, or one that sees as much.

    A renderer takes neither distortion nor a principal point off the middle.
    """
    centre = (camera.width - 1) / 2, (camera.height - 1) / 2
    if (camera.cx, camera.cy) == centre and not any(camera.distortion):
        return camera
    reach = np.nanmax(np.abs(pixel_rays(camera)), axis=(1, 2))
    width, height = (
        2 * math.ceil(f * r + 2) for f, r in zip((camera.fx, camera.fy), reach, strict=True)
    )
    return Intrinsics(width, height, camera.fx, camera.fy, (width - 1) / 2, (height - 1) / 2)


def _distort(
    x: np.ndarray, y: np.ndarray, distortion: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    # The models plumb_bob and rational_polynomial of sensor_msgs/CameraInfo.
    k1, k2, p1, p2, k3, *divisor = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if divisor:
        k4, k5, k6 = divisor
        radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


class Reprojection:
    """
    How one camera looks through another's depth images; they share one optical centre and axes.

    The latter are of the camera `source`. If ``radial``, they hold distances along the ray instead
    of along the axis. ``sensor`` has the thresholds of depth jumps, across which nothing is
    interpolated.

    Attributes
    ----------
    outside : numpy.ndarray
        (H, W) bool, where the camera's ray leaves the source's image. `depth` and `reflectivity`
        repeat the image's border there, so that its end is not taken for an edge; what is made
        of them is to be masked.
    identical : bool
        Whether the pixels of both cameras are the same.

    """

    def __init__(
        self,
        camera: Intrinsics,
        source: Intrinsics,
        radial: bool = False,
        sensor: Sensor = DEFAULT_SENSOR,
    ) -> None:
        """Look every ray up once."""
        self.camera = camera
        self.source = source
        self.radial = radial
        self._sensor = sensor
        x, y = self.rays = pixel_rays(camera)
        with np.errstate(invalid='ignore', over='ignore'):
            x, y = _distort(x, y, source.distortion)
            u = source.fx * x + source.cx
            v = source.fy * y + source.cy
            self.outside = ~(
                (u > -0.5) & (u < source.width - 0.5) & (v > -0.5) & (v < source.height - 0.5)
            )
        u = np.clip(np.nan_to_num(u), 0, source.width - 1)
        v = np.clip(np.nan_to_num(v), 0, source.height - 1)
        column, row = np.rint(u), np.rint(v)
        self._index = (row * source.width + column).astype(np.int32).ravel()
        self._du = (u - column).astype(np.float32).ravel()
        self._dv = (v - row).astype(np.float32).ravel()
        self.identical = bool(
            (camera.height, camera.width) == (source.height, source.width)
            and (self._index == np.arange(self._index.size)).all()
            and max(np.abs(self._du).max(), np.abs(self._dv).max()) < 1e-4
        )

    @property
    def lines(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return where in the source each pixel looks, (H * W,) each.

        That is the source's pixel that its ray falls into (int32, flat; -1 where the distortion
        cannot be inverted), and how far from its middle, columns and rows (float32, pixels).
        """
        lost = np.isnan(self.rays[0]).ravel()
        return np.where(lost, np.int32(-1), self._index), self._du, self._dv

    @cached_property
    def _ray_length(self) -> np.ndarray:
        length: np.ndarray = on_images(surfaces.ray_length)(*pixel_rays(self.source))
        return length.astype(np.float32)

    def depth(self, image: np.ndarray) -> np.ndarray:
        """
        Look a depth image up: (H, W) float32, metres along the optical axis, NaN for nothing.

        ``image`` is (source.height, source.width) float32, metres; whatever is no positive finite
        number means nothing.
        """
        if self.radial:
            image = image / self._ray_length
        if self.identical:
            return image
        out = np.empty((self.camera.height, self.camera.width), np.float32)
        _look_up(*tangents(image, self._sensor), self._index, self._du, self._dv, out.ravel())
        return out

    def reflectivity(self, image: np.ndarray) -> np.ndarray:
        """Look a (source.height, source.width) reflectivity image up: the nearest pixel's."""
        if self.identical:
            return image
        return image.ravel()[self._index].reshape(self.camera.height, self.camera.width)


@loop(error_model='numpy', fastmath=FAST)
def _look_up(p, across, down, index, du, dv, out):
    width = across.shape[1]
    for pixel in range(out.size):
        y = index[pixel] // width
        x = index[pixel] % width
        here = p[y + PAD, x + PAD]
        value = _beside(here, across[y, x], down[y, x], du[pixel], dv[pixel])
        out[pixel] = _ONE / value if here > _ZERO else _NAN


def points(depth: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """
    Turn depth, (H, W) metres along the optical axis, into points.

    ``rays`` are (2, H, W) from `pixel_rays`. Points are (H, W, 3) float32 x, y, z in the optical
    frame, NaN where depth is.
    """
    out = np.empty((*depth.shape, 3), np.float32)
    out[..., 0] = rays[0] * depth
    out[..., 1] = rays[1] * depth
    out[..., 2] = depth
    return out


def ray_length(K: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:  # noqa: N803
    """
    Return how many times longer each pixel's ray is than its depth.

    A simulator's distance along the ray ("range", "distance to camera"), divided by it, is the
    depth along the optical axis.

    Parameters
    ----------
    K : numpy.ndarray
        (3, 3) camera matrix, pixels; pixel centres have whole-number coordinates.
    shape : tuple of int
        (H, W) of the image.

    Returns
    -------
    numpy.ndarray
        (H, W) float32, 1 on the optical axis and more elsewhere.

    """
    x = (np.arange(shape[1]) - K[0, 2]) / K[0, 0]
    y = (np.arange(shape[0])[:, None] - K[1, 2]) / K[1, 1]
    length: np.ndarray = on_images(surfaces.ray_length)(x, y)
    return length.astype(np.float32)


def check_clipping_planes(near: float, far: float) -> None:
    """Refuse distances (metres) that no renderer draws between."""
    if not 0 < near < far < math.inf:
        raise InputError(f'near, far: must be 0 < near < far in metres, got {near}, {far}')


def depth_from_z_buffer(buffer: Any, near: float, far: float) -> np.ndarray:
    """
    Return the depth that a z-buffer of OpenGL or Vulkan stands for.

    Such a buffer is 0 at the near plane, 1 at the far plane and linear in 1 / depth between them.

    Parameters
    ----------
    buffer : array_like
        (..., H, W) values of a perspective camera's z-buffer, 0 to 1.
    near, far : float
        Distances of the clipping planes that the image was drawn with, metres.

    Returns
    -------
    numpy.ndarray
        (..., H, W) float32, metres along the optical axis; NaN at the far plane, where nothing
        was drawn.

    Raises
    ------
    InputError
        When the planes are not ``0 < near < far`` or a value is not 0 to 1.

    """
    check_clipping_planes(near, far)
    nearness = 1.0 - np.asarray(buffer, np.float64)
    if not ((nearness >= 0) & (nearness <= 1)).all():
        raise InputError('buffer: must be a z-buffer with values 0 to 1')
    depth = near * far / (near + nearness * (far - near))
    return np.where(nearness > 0, depth, np.nan).astype(np.float32)

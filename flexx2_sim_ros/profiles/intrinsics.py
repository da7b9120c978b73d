"""A pinhole camera's intrinsic parameters."""

from collections.abc import Iterable
from dataclasses import dataclass
import math
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
import numpy as np

# By the number of coefficients; names of sensor_msgs/CameraInfo.
DISTORTION_MODELS = {5: 'plumb_bob', 8: 'rational_polynomial'}
# Focal lengths of a unit matrix are 1 pixel; 0.02 image sizes see 176 degrees, more than any lens.
_LEAST_FOCAL_SIZES = 0.02
_SMALLEST = 8  # pixels; in such images the principal point may well be in the first one


@dataclass(frozen=True)
class Intrinsics:
    """
    Pinhole intrinsics with an optional ``plumb_bob`` or ``rational_polynomial`` distortion.

    Pixel centres have whole-number coordinates, so the principal point of a symmetric camera is
    ``((width - 1) / 2, (height - 1) / 2)``. The camera frame is optical: x right, y down,
    z forward.

    Attributes
    ----------
    width, height : int
        Image size in pixels.
    fx, fy : float
        Focal lengths in pixels.
    cx, cy : float
        Principal point in pixels.
    distortion : tuple of float
        As in ``sensor_msgs/CameraInfo``: ``(k1, k2, p1, p2, k3)`` of a ``plumb_bob`` lens, or
        ``(k1, k2, p1, p2, k3, k4, k5, k6)`` of a ``rational_polynomial`` lens; zeros for none.

    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse what cannot be a camera."""
        if self.width < 1 or self.height < 1:
            raise InputError(
                f'image size: must be at least 1 x 1, got {self.width} x {self.height}'
            )
        for name in ('fx', 'fy'):
            value = getattr(self, name)
            if not 1e-3 <= value <= 1e6:
                raise InputError(f'K: {name}: must be 0.001 to 1,000,000 pixels, got {value}')
        for name in ('cx', 'cy'):
            value = getattr(self, name)
            if not abs(value) <= 1e6:
                raise InputError(f'K: {name}: must be at most 1,000,000 pixels, got {value}')
        if len(self.distortion) not in DISTORTION_MODELS or not all(
            map(math.isfinite, self.distortion)
        ):
            raise InputError(
                'distortion: must be five finite numbers (k1, k2, p1, p2, k3), or eight with k4, '
                f'k5, k6, got {shown(self.distortion)}'
            )

    @classmethod
    def from_matrix(
        cls,
        K: Any,
        width: int,
        height: int,  # noqa: N803
        distortion: Any = (),
    ) -> 'Intrinsics':
        """
        Build from a 3 x 3 camera matrix.

        Parameters
        ----------
        K : array_like
            (3, 3) or 9 numbers in row order, pixels.
        width, height : int
            Image size in pixels.
        distortion : sequence of float
            Up to five ``plumb_bob`` or six to eight ``rational_polynomial`` coefficients; missing
            ones are zero.

        Raises
        ------
        InputError
            For another shape, skew, or values that cannot be a camera.

        """
        try:
            matrix = np.asarray(K, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f'K: must be a 3 x 3 matrix of numbers, got {shown(K)}') from error
        if matrix.size != 9:
            raise InputError(f'K: must have shape (3, 3), got {matrix.shape}')
        matrix = matrix.reshape(3, 3)
        if matrix[2, 2] != 1.0 or matrix[0, 1] or matrix[1, 0] or matrix[2, 0] or matrix[2, 1]:
            raise InputError(
                f'K: must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {matrix.tolist()}'
            )
        camera = cls(
            int(width),
            int(height),
            float(matrix[0, 0]),
            float(matrix[1, 1]),
            float(matrix[0, 2]),
            float(matrix[1, 2]),
            full_distortion(distortion),
        )
        camera._refuse_other_units()
        return camera

    def _refuse_other_units(self) -> None:
        # A matrix that was never calibrated, or whose numbers are fractions of the image.
        unit = min(self.fx / self.width, self.fy / self.height) < _LEAST_FOCAL_SIZES
        large = min(self.width, self.height) > _SMALLEST
        if unit or (large and 0 < self.cx < 1 and 0 < self.cy < 1):
            raise InputError(
                f'K: must be a calibrated camera matrix in pixels, got fx {self.fx:g}, '
                f'fy {self.fy:g}, cx {self.cx:g}, cy {self.cy:g} for {self.width} x {self.height} '
                'pixels'
            )

    @classmethod
    def from_field_of_view(
        cls, width: int, height: int, horizontal_deg: float, vertical_deg: float
    ) -> 'Intrinsics':
        """Build a symmetric camera from its image size (pixels) and view angles (degrees)."""
        return cls(
            width,
            height,
            width / 2 / math.tan(math.radians(horizontal_deg) / 2),
            height / 2 / math.tan(math.radians(vertical_deg) / 2),
            (width - 1) / 2,
            (height - 1) / 2,
        )

    def resized(self, width: int, height: int) -> 'Intrinsics':
        """Return a camera without distortion that has this field of view in another image size."""
        across, down = width / self.width, height / self.height
        return Intrinsics(
            width,
            height,
            self.fx * across,
            self.fy * down,
            (self.cx + 0.5) * across - 0.5,
            (self.cy + 0.5) * down - 0.5,
        )

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Return the view angles of a symmetric camera of this size and these focal lengths."""
        return (
            math.degrees(2 * math.atan(self.width / 2 / self.fx)),
            math.degrees(2 * math.atan(self.height / 2 / self.fy)),
        )

    @property
    def matrix(self) -> np.ndarray:
        """Return K as a (3, 3) float64 array."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distortion_model(self) -> str:
        """Return the distortion's name in ``sensor_msgs/CameraInfo``."""
        return DISTORTION_MODELS[len(self.distortion)]


def full_distortion(coefficients: Iterable[float]) -> tuple[float, ...]:
    """
    Return distortion coefficients with the zeros that were left out at their end.

    Up to eight, in the order of `Intrinsics.distortion`, become five, or eight if there are more
    than five. Raises InputError when there are more than eight.
    """
    given = [float(value) for value in coefficients]
    for length in DISTORTION_MODELS:
        if len(given) <= length:
            return (*given, *[0.0] * (length - len(given)))
    raise InputError(
        f'distortion: must have at most eight coefficients (rational_polynomial), got {len(given)}'
    )

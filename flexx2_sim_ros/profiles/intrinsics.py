"""A pinhole camera's intrinsic parameters."""

from dataclasses import dataclass
import math
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
import numpy as np


@dataclass(frozen=True)
class Intrinsics:
    """
    Pinhole intrinsics with optional ``plumb_bob`` distortion.

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
        ``(k1, k2, p1, p2, k3)`` as in ``sensor_msgs/CameraInfo``; zeros for none.

    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

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
        if len(self.distortion) != 5 or not all(map(math.isfinite, self.distortion)):
            raise InputError(
                'distortion: must be five finite numbers (k1, k2, p1, p2, k3), got '
                f'{self.distortion}'
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
            Up to five ``plumb_bob`` coefficients; missing ones are zero.

        Returns
        -------
        Intrinsics

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
        coefficients = [float(value) for value in distortion]
        if len(coefficients) > 5:
            raise InputError(
                'distortion: must have at most five coefficients (plumb_bob), got '
                f'{len(coefficients)}'
            )
        coefficients += [0.0] * (5 - len(coefficients))
        return cls(
            int(width),
            int(height),
            float(matrix[0, 0]),
            float(matrix[1, 1]),
            float(matrix[0, 2]),
            float(matrix[1, 2]),
            tuple(coefficients),  # type: ignore[arg-type]
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

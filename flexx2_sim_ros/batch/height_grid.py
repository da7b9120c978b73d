"""The heights around each robot, on a grid, from what its cameras see."""

from typing import Any

from flexx2_sim_ros.batch import robot_kernels
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.consumers.height_grid import AHEAD, LEAST, LEFT, REACH
import numpy as np
import warp as wp


class HeightGrid:
    """
    The mean height of all points near each point of a grid, in every environment.

    Parameters
    ----------
    num_envs : int
        N.
    camera : Intrinsics
        Of the depth images, without distortion.
    device : warp.Device or str
        Where the depth images are.
    reach : float
        Points no further from a grid point than this, ahead and to the left, count, metres.
    least : int
        Fewer points are none.
    ahead, left : numpy.ndarray
        (A,) and (L,) metres, evenly spaced by the same distance: the grid points.

    """

    def __init__(
        self,
        num_envs: int,
        camera: Intrinsics,
        device: Any,
        reach: float = REACH,
        least: int = LEAST,
        ahead: np.ndarray = AHEAD,
        left: np.ndarray = LEFT,
    ) -> None:
        """Start empty."""
        self._camera, self._reach, self._least = camera, reach, least
        self._first, self._spacing = wp.vec2f(ahead[0], left[0]), float(ahead[1] - ahead[0])
        self._total, self._count, self._heights = (
            wp.zeros((num_envs, len(ahead), len(left)), dtype=wp.float32, device=device)
            for _ in range(3)
        )

    def add(
        self, depth: wp.array, position: np.ndarray | wp.array, rotation: np.ndarray | wp.array
    ) -> None:
        """
        Add the points of a depth image of every environment.

        Parameters
        ----------
        depth : warp.array
            (N, H, W) float32, metres along the optical axis; NaN or 0 where invalid.
        position, rotation : numpy.ndarray or warp.array
            (N, 3) metres and (N, 3, 3): the optical frame (x right, y down, z ahead) in the
            grid's frame (x ahead, y left, z up). Warp: (N,) ``vec3f`` and ``mat33f`` on the
            device.

        """
        camera, device = self._camera, self._total.device
        wp.launch(
            robot_kernels.add_points,
            depth.shape,
            [
                depth,
                wp.vec2f(camera.fx, camera.fy),
                wp.vec2f(camera.cx, camera.cy),
                _on(device, position, wp.vec3f),
                _on(device, rotation, wp.mat33f),
                self._first,
                self._spacing,
                self._reach,
                self._total,
                self._count,
            ],
            device=device,
        )

    def heights(self) -> wp.array:
        """Return (N, A, L) float32 metres, NaN without a measurement."""
        wp.launch(
            robot_kernels.mean,
            self._total.shape,
            [self._total, self._count, float(self._least), self._heights],
            device=self._total.device,
        )
        return self._heights

    def clear(self) -> None:
        """Start empty again."""
        self._total.zero_()
        self._count.zero_()


def _on(device: Any, values: np.ndarray | wp.array, dtype: Any) -> wp.array:
    if isinstance(values, np.ndarray):
        return wp.array(values, dtype=dtype, device=device)
    return values

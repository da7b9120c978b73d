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

    """

    def __init__(
        self,
        num_envs: int,
        camera: Intrinsics,
        device: Any,
        reach: float = REACH,
        least: int = LEAST,
    ) -> None:
        """Start empty."""
        self._camera, self._reach, self._least = camera, reach, least
        self._total, self._count, self._heights = (
            wp.zeros((num_envs, len(AHEAD), len(LEFT)), dtype=wp.float32, device=device)
            for _ in range(3)
        )

    def add(self, depth: wp.array, position: np.ndarray, rotation: np.ndarray) -> None:
        """
        Add the points of a depth image of every environment.

        Parameters
        ----------
        depth : warp.array
            (N, H, W) float32, metres along the optical axis; NaN or 0 where invalid.
        position, rotation : numpy.ndarray
            (N, 3) metres and (N, 3, 3): the optical frame (x right, y down, z ahead) in the
            grid's frame (x ahead, y left, z up).

        """
        camera, device = self._camera, self._total.device
        wp.launch(
            robot_kernels.add_points,
            depth.shape,
            [
                depth,
                wp.vec2f(camera.fx, camera.fy),
                wp.vec2f(camera.cx, camera.cy),
                wp.array(position, dtype=wp.vec3f, device=device),
                wp.array(rotation, dtype=wp.mat33f, device=device),
                wp.vec2f(AHEAD[0], LEFT[0]),
                AHEAD[1] - AHEAD[0],
                self._reach,
                self._total,
                self._count,
            ],
            device=device,
        )

    def heights(self) -> wp.array:
        """Return (N, 11, 7) float32 metres over `AHEAD` and `LEFT`, NaN without a measurement."""
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

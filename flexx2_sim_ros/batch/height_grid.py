"""The heights around each robot, on a grid, from what its cameras see."""

from typing import Any

from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.frame import OPTIONS
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.consumers.height_grid import AHEAD, from_cell, LEAST, LEFT, nearest_cell, REACH
import numpy as np
import warp as wp

wp.set_module_options(OPTIONS)

_nearest_cell = compiled(nearest_cell)
_from_cell = compiled(from_cell)


@wp.kernel
def add_points(
    depth: wp.array3d(dtype=wp.float32),
    focal: wp.vec2f,
    centre: wp.vec2f,
    position: wp.array(dtype=wp.vec3f),
    rotation: wp.array(dtype=wp.mat33f),
    first: wp.vec2f,
    pitch: wp.float32,
    reach: wp.float32,
    total: wp.array3d(dtype=wp.float32),
    count: wp.array3d(dtype=wp.float32),
):
    """Add the point of a pixel to the cell it lies in, if it lies near the middle."""
    n, v, u = wp.tid()
    z = depth[n, v, u]
    if not z > 0.0:
        return
    ray = wp.vec3f(
        (wp.float32(u) - centre[0]) / focal[0], (wp.float32(v) - centre[1]) / focal[1], 1.0
    )
    point = position[n] + rotation[n] * (z * ray)
    row = _nearest_cell(point[0], first[0], pitch)
    column = _nearest_cell(point[1], first[1], pitch)
    i, j = wp.int32(row), wp.int32(column)
    if i < 0 or j < 0 or i >= total.shape[1] or j >= total.shape[2]:
        return
    across = wp.max(
        _from_cell(point[0], first[0], pitch, row), _from_cell(point[1], first[1], pitch, column)
    )
    if across <= reach:
        wp.atomic_add(total, n, i, j, point[2])
        wp.atomic_add(count, n, i, j, 1.0)


@wp.kernel
def mean(
    total: wp.array3d(dtype=wp.float32),
    count: wp.array3d(dtype=wp.float32),
    least: wp.float32,
    out: wp.array3d(dtype=wp.float32),
):
    """Write the mean height in a cell, NaN below ``least`` points."""
    n, i, j = wp.tid()
    seen = count[n, i, j]
    out[n, i, j] = wp.where(seen >= least, total[n, i, j] / wp.max(seen, 1.0), wp.nan)


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
            add_points,
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
            mean,
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

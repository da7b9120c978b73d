"""Tiles of a camera's image, and the geoms that the rays of each can hit."""

from itertools import pairwise

from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import mujoco
import numpy as np

# Pixels. Smaller tiles have fewer geoms, but each takes 10 us on its own.
_SIDE = 32


class RayTiles:
    """
    Rectangles of about 32 x 32 pixels.

    Attributes
    ----------
    order : numpy.ndarray
        (H * W,) int64 flat indices of pixels, tile after tile.
    parts : list of slice
        Where each tile is in `order`.

    """

    def __init__(self, intrinsics: Intrinsics) -> None:
        """Cut the image."""
        rows, columns = (_borders(n) for n in (intrinsics.height, intrinsics.width))
        pixels = np.arange(intrinsics.height * intrinsics.width).reshape(intrinsics.height, -1)
        blocks = [
            block.ravel()
            for strip in np.split(pixels, rows[1:-1])
            for block in np.split(strip, columns[1:-1], axis=1)
        ]
        self.order = np.concatenate(blocks)
        ends = np.cumsum([0, *(block.size for block in blocks)]).tolist()
        self.parts = [slice(*both) for both in pairwise(ends)]
        # Planes through the camera between pixels, in its frame (y up, looking along -z): normals
        # to the right, and down.
        across = (columns - 0.5 - intrinsics.cx) / intrinsics.fx
        down = (rows - 0.5 - intrinsics.cy) / intrinsics.fy
        self._across = np.stack([across**0, 0 * across, across], axis=1)
        self._down = np.stack([0 * down, -(down**0), down], axis=1)

    def geoms(self, model: mujoco.MjModel, data: mujoco.MjData, camera: int) -> np.ndarray:
        """
        Return (tiles, ngeom) bool: the geoms whose boxes reach into a tile's view, and planes.

        `data` is a state of `model`, complete up to its positions; `camera` the camera's id.
        """
        turn = data.cam_xmat[camera].reshape(3, 3)
        axes = data.geom_xmat.reshape(-1, 3, 3).transpose(0, 2, 1) @ turn  # (ngeom, axis, xyz)
        middle, half = np.split(model.geom_aabb.reshape(-1, 6), 2, axis=1)
        place = (data.geom_xpos - data.cam_xpos[camera]) @ turn
        place += (middle[:, None] @ axes)[:, 0]
        ahead = place[:, 2] - (np.abs(axes[..., 2]) * half).sum(axis=1) < 0
        seen = (
            _between(place, axes, half, self._down)[:, None]
            & _between(place, axes, half, self._across)[None]
            & ahead
        )
        return seen.reshape(-1, model.ngeom) | (
            model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        )


def _borders(pixels: int) -> np.ndarray:
    return np.linspace(0, pixels, max(round(pixels / _SIDE), 1) + 1).astype(int)


def _between(
    place: np.ndarray, axes: np.ndarray, half: np.ndarray, planes: np.ndarray
) -> np.ndarray:
    # (strips, ngeom) whether boxes reach between consecutive planes.
    middle = planes @ place.T
    reach = (np.abs(planes @ axes.transpose(0, 2, 1)) @ half[..., None])[..., 0].T
    return (middle + reach >= 0)[:-1] & (middle - reach <= 0)[1:]

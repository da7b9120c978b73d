"""Real time-of-flight frames, where they are: beside the repository, in ../shared/data."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
# Nominal, of Kinect v2: a calibration of these very views gives 378 to 387 px.
FOCAL, CENTRE = 365.5, (255.5, 211.5)


def load(name):
    """Open a file of real frames, or skip the test."""
    path = DATA / name
    if not path.is_file():
        pytest.skip(f'{path} is not there')
    return np.load(path, allow_pickle=False)


@dataclass(frozen=True)
class View:
    """
    One frame of a chessboard.

    * `depth`: (H, W) metres, NaN where invalid
    * `amplitude`: (H, W) infrared intensity
    * `K`: (3, 3) nominal camera matrix of the crop
    * `corners`: (35, 2) inner corners, pixels of the crop
    """

    depth: np.ndarray
    amplitude: np.ndarray
    K: np.ndarray  # noqa: N815
    corners: np.ndarray

    @cached_property
    def squares(self):
        """
        Return where each pixel is on the board, by its corners and 30 mm squares.

        Returns (2, H, W) in squares from the first inner corner; (H, W) metres, the depth of the
        board's plane; and the distance of the board's middle, metres.
        """
        grid = np.stack(np.meshgrid(np.arange(5), np.arange(7)), -1).reshape(-1, 2) * 0.03
        points = np.c_[grid, np.zeros(35)]

        def error(pose):
            seen = Rotation.from_rotvec(pose[:3]).apply(points) + pose[3:]
            pixels = seen[:, :2] / seen[:, 2:] * FOCAL + self.K[:2, 2]
            return (pixels - self.corners).ravel()

        best = least_squares(error, _start(grid, (self.corners - self.K[:2, 2]) / FOCAL))
        turn, shift = Rotation.from_rotvec(best.x[:3]).as_matrix(), best.x[3:]
        v, u = np.indices(self.depth.shape)
        rays = np.stack([(u - self.K[0, 2]) / FOCAL, (v - self.K[1, 2]) / FOCAL, np.ones(u.shape)])
        depth = (turn[:, 2] @ shift) / np.tensordot(turn[:, 2], rays, 1)
        board = np.tensordot(turn.T, rays * depth - shift[:, None, None], 1)
        return board[:2] / 0.03, depth, float((turn @ (0.06, 0.09, 0.0) + shift)[2])


def _start(grid, rays):
    """Return a pose to start from: that of the homography from the board to its image."""
    rows = [
        row
        for (x, y), (u, v) in zip(grid, rays, strict=True)
        for row in ((x, y, 1, 0, 0, 0, -u * x, -u * y, -u), (0, 0, 0, x, y, 1, -v * x, -v * y, -v))
    ]
    matrix = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    matrix *= np.sign(matrix[2, 2]) / np.linalg.norm(matrix[:, :2], axis=0).mean()
    axes = np.c_[matrix[:, :2], np.cross(*matrix[:, :2].T)]
    left, _, right = np.linalg.svd(axes)
    return np.r_[Rotation.from_matrix(left @ right).as_rotvec(), matrix[:, 2]]


def kinect_views():
    """Return the 102 views of the Kinect v2, each a crop around the board."""
    views = []
    with load('kinect2_chessboard.npz') as data:
        offsets = data['offset']
        depth, infrared = data['depth_mm'], data['ir16']
        for number, (x0, y0, x1, y1) in enumerate(data['box_x0y0x1y1']):
            part, shape = slice(*offsets[number : number + 2]), (y1 - y0, x1 - x0)
            metres = depth[part].reshape(shape) / np.float32(1000)
            matrix = np.array([[FOCAL, 0, CENTRE[0] - x0], [0, FOCAL, CENTRE[1] - y0], [0, 0, 1]])
            views.append(
                View(
                    np.where(metres > 0, metres, np.float32(np.nan)),
                    infrared[part].reshape(shape).astype(np.float32),
                    matrix,
                    data['corners_px'][number].astype(np.float64) - (x0, y0),
                )
            )
    return views

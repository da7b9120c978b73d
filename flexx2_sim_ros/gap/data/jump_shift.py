"""
Depth jumps: how many pixels a recording shows them away from where its clean depth has them.

A surface that faces the camera has the same depth after the camera was moved sideways. Only its
outline moves.
"""

from dataclasses import dataclass
import math

from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.data.frames import surface_of
from flexx2_sim_ros.physics.poses import ray_slopes
from flexx2_sim_ros.profiles.sensor import Sensor
import numpy as np


@dataclass(frozen=True)
class Jumps:
    """
    Depth jumps of a clean frame, each looked at along its row or column.

    * `across`: (N, 2 reach) int, flat indices of the pixels across each jump, from front to back;
      the first half is on the surface in front.
    * `middle`: (N,) metres, between the depths on either side.
    * `slopes`: (6, N) pixels by which the surface in front reaches farther, per metre and per
      degree of motion of the camera, as in `pose.moved`.
    """

    across: np.ndarray
    middle: np.ndarray
    slopes: np.ndarray

    def shift(self, depth: np.ndarray) -> np.ndarray:
        """
        Return by how many pixels the surface in front reaches farther than in the clean frame.

        `depth` is (H, W) metres, NaN where invalid; the result (N,), NaN where the pixels do not
        show one jump.
        """
        seen = depth.ravel()[self.across]
        unknown = ~np.isfinite(seen)
        with np.errstate(invalid='ignore'):
            front, back = seen < self.middle[:, None], seen >= self.middle[:, None]
        reach = self.across.shape[1] // 2
        # An invalid pixel may lie on either side.
        count = front.sum(axis=1) + 0.5 * unknown.sum(axis=1)
        clear = front[:, 0] & back[:, -1] & (unknown.sum(axis=1) <= reach / 2)
        return np.where(clear, count - reach, np.nan)


def jumps_of(
    clean: np.ndarray, sigma: np.ndarray, compared: np.ndarray, K: np.ndarray, sensor: Sensor
) -> Jumps:
    """
    Find the jumps of a clean frame that have one surface on each side.

    `clean` is (H, W) float32 metres, known where `compared`, (H, W) bool; `K` is the (3, 3) camera
    matrix. A jump is larger than several times `sigma`, (H, W) metres, the standard deviation of a
    depth.
    """
    surface = surface_of(clean, K, sensor)
    usable = np.where(compared & (clean > 0), clean, np.float32(np.nan))
    index = np.arange(clean.size).reshape(clean.shape)
    reach = max(clean.shape[1] // REGISTRATION.jump_reach, 2)
    parts = []
    for jumps, turn in ((surface.row_jumps, False), (surface.column_jumps, True)):
        depth, noise, breaks, flat = (
            one.T if turn else one for one in (usable, sigma, jumps, index)
        )
        for sign in (1, -1):
            across, middle, tilt = _across(depth, noise, breaks, flat, sign, reach)
            slopes = _slopes(usable, across, sign, tilt, turn, K)
            parts.append((across, middle, slopes.T))
    across, middle, slopes = (np.concatenate(one) for one in zip(*parts, strict=True))
    return Jumps(across, middle, slopes.T)


def _across(
    clean: np.ndarray,
    sigma: np.ndarray,
    jumps: np.ndarray,
    index: np.ndarray,
    sign: int,
    reach: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # `across` and `middle` of the jumps between columns whose surface in front has the lower
    # columns (sign 1) or the higher ones (-1); and by how many pixels it reaches farther in each
    # next row.
    side = REGISTRATION.jump_side
    rows, columns = np.nonzero(jumps)
    keep = (columns >= reach - 1) & (columns < clean.shape[1] - reach)
    keep &= (rows >= side) & (rows < clean.shape[0] - side)
    rows = rows[keep, None]
    window = columns[keep, None] + np.arange(1 - reach, reach + 1)[::sign]
    with np.errstate(invalid='ignore'):
        seen = clean[rows, window]
        near, far = seen[:, reach - 1], seen[:, reach]
        middle = (near + far) / 2
        front = seen < middle[:, None]
        noise = np.maximum(
            sigma[rows[:, 0], window[:, reach - 1]], sigma[rows[:, 0], window[:, reach]]
        )
        # Larger than biases that surfaces may have: pixels count as near or far.
        good = far - near > np.maximum(REGISTRATION.jump_sigmas * noise, 2 * REGISTRATION.outlier)
        good &= front[:, :reach].all(axis=1) & (seen[:, reach:] >= middle[:, None]).all(axis=1)
        beside = [clean[rows + step, window] for step in (-side, side)]
        # Both rows must show the jump: an outline may end there.
        for one in beside:
            good &= (one[:, 0] < middle) & (one[:, -1] >= middle) & np.isfinite(one).all(axis=1)
        before, after = ((one < middle[:, None]).sum(axis=1) for one in beside)
    tilt = (after - before) / (2 * side)
    good &= np.abs(tilt) <= 1  # Others are looked at in the other direction.
    return index[rows, window][good], middle[good], tilt[good]


def _slopes(
    clean: np.ndarray, across: np.ndarray, sign: int, tilt: np.ndarray, turn: bool, K: np.ndarray
) -> np.ndarray:
    # (6, N) as in `Jumps`.
    v, u = np.unravel_index(across[:, across.shape[1] // 2 - 1], clean.shape)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    du, dv = ray_slopes(x, y, clean[v, u], math.radians(1))
    du, dv = K[0, 0] * du, K[1, 1] * dv
    return np.asarray(sign * dv - tilt * du if turn else sign * du - tilt * dv)

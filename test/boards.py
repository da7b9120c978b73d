"""Clean depth images of flat boards, computed analytically: what the camera tests look at."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.edge_jitter import edge_sigma
from flexx2_sim_ros.characterize.tiles import gaussian_kl
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np

__all__ = ['Board', 'K', 'board', 'edge_sigma', 'mean_kl', 'recording_of']

# Where boards are recorded: metres, degrees.
PLACES = ((0.7, 0), (0.7, 40), (1.0, 20), (1.5, 0), (1.5, 50), (2.0, 30), (2.5, 0), (2.5, 45))
K = np.array([[210.6, 0.0, 111.5], [0.0, 212.9, 85.5], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Board:
    """
    A board on the optical axis, turned about the vertical, and the truth about it.

    * `depth`: (H, W) float32 metres; ``background`` (NaN for none) beside the board
    * `incidence`: (H, W) float64 radians, NaN beside the board
    * `K`: (3, 3) camera matrix of the (possibly cropped) image
    """

    depth: np.ndarray
    incidence: np.ndarray
    K: np.ndarray  # noqa: N815


def board(
    distance, angle_deg, *, half_width=math.inf, background=math.nan, size=(172, 224), turn='yaw'
):
    """
    Draw a board.

    * `distance`: depth at the principal point, metres
    * `angle_deg`: angle between the board's normal and the optical axis
    * `half_width`: half the board's extent along the direction in which it is turned, metres
    * `background`: depth of the wall behind, metres
    * `size`: height and width of the image, cut from the middle of the full one
    * `turn`: ``yaw``: about the vertical, so that left and right edges are upright; ``pitch``:
      about the horizontal, so that upper and lower edges are level
    """
    height, width = size
    matrix = K.copy()
    matrix[0, 2] -= (224 - width) / 2
    matrix[1, 2] -= (172 - height) / 2
    v, u = np.mgrid[:height, :width].astype(np.float64)
    x = (u - matrix[0, 2]) / matrix[0, 0]
    y = (v - matrix[1, 2]) / matrix[1, 1]
    angle = math.radians(angle_deg)
    across = x if turn == 'yaw' else y
    facing = math.cos(angle) + across * math.sin(angle)  # normal . ray
    depth = distance * math.cos(angle) / np.where(facing > 0, facing, np.nan)
    incidence = np.arccos(facing / np.sqrt(1 + x**2 + y**2))
    on_board = np.abs(depth * across / math.cos(angle)) <= half_width
    return Board(
        np.where(on_board, depth, background).astype(np.float32),
        np.where(on_board, incidence, np.nan),
        matrix,
    )


def recording_of(distance=1.0, angle=15.0, frames=12, size=(60, 80), distort=None, seed=None):
    """
    Make the arrays of a recording of a board that fills the image, with the noise of a mode.

    `distort`: changes the (frames, H, W) standard normal numbers that the noise is made of
    """
    target = board(distance, angle, size=size)
    sigma = flexx2().mode('Mode_9_30fps').noise.sigma_z(target.depth, target.incidence)
    generator = np.random.default_rng(round(1000 * distance + angle) if seed is None else seed)
    noise = generator.standard_normal((frames, *size))
    if distort is not None:
        noise = distort(noise)
    return {
        'depth': (target.depth + sigma * noise).astype(np.float32),
        'K': target.K,
        'stamp': np.arange(frames) / 30,
        'usecase': 'Mode_9_30fps',
    }


def mean_kl(samples, clean, sigma):
    """Return the mean divergence of frames from the model, nats: each pixel has a Gaussian."""
    error = samples.astype(np.float64) - clean
    variance = error.var(axis=0, ddof=1)
    return float(np.mean(gaussian_kl(variance, error.mean(axis=0) ** 2, np.log(variance), sigma)))

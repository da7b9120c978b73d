"""The scene of `flexx2 effects show`, in which every effect is visible."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.physics.geometry import pixel_rays
import numpy as np

_WALL, _FLOOR, _SIDE, _FAR = 3.4, 0.42, 1.0, 6.7  # metres: behind, below, right, through the door
_SHADES = 0.9, 0.01  # reflectivity of the chart, left and right
CHART = 1.5  # metres
PANEL = 2.2  # behind it by less than c / 4f, so that mixed phases give a depth in between


@dataclass(frozen=True)
class DrawnRoom:
    """
    Depth and reflectivity of the room.

    Attributes
    ----------
    depth : numpy.ndarray
        (H, W) metres along the optical axis.
    reflectivity : numpy.ndarray
        (H, W) in 0..1.

    """

    depth: np.ndarray
    reflectivity: np.ndarray


def room(forward: float = 0.0) -> DrawnRoom:
    """
    Return the view of a camera that has moved forward.

    A bright wall with a door to a far one, a wall at a right angle to it, a floor, a chart of
    gray shades before a panel, a column, and a white ball close by.

    Parameters
    ----------
    forward : float
        Metres along the optical axis, at most 0.3.

    """
    x, y = pixel_rays(flexx2().intrinsics)
    depth = np.full(x.shape, _FAR - forward)
    shade = np.full(x.shape, 0.8)

    def put(distance: np.ndarray, reflectivity: np.ndarray | float, where: np.ndarray) -> None:
        with np.errstate(invalid='ignore'):
            nearer = where & (distance > 0) & (distance < depth)
        depth[nearer] = distance[nearer]
        shade[nearer] = np.broadcast_to(reflectivity, x.shape)[nearer]

    with np.errstate(divide='ignore', invalid='ignore'):
        wall = np.full(x.shape, _WALL - forward)
        put(wall, 0.8, ~((x * wall > -1.35) & (x * wall < -0.85) & (y * wall > -0.9)))
        put(_SIDE / x, 0.8, x > 0)
        put(_FLOOR / y, 0.4, y > 0)
        chart = np.full(x.shape, CHART - forward)
        across, down = x * chart, y * chart
        left, right = _SHADES
        put(
            chart,
            left * (right / left) ** np.clip((across + 0.15) / 0.5, 0, 1),
            (across > -0.15) & (across < 0.35) & (down > -0.45) & (down < 0.05),
        )
        panel = np.full(x.shape, PANEL - forward)
        put(panel, 0.5, (np.abs(x * panel + 0.2) < 0.28) & (np.abs(y * panel + 0.3) < 0.48))
        # An upright column: |(x z, z) - centre| = radius.
        place, radius = (-1.1, 2.2 - forward), 0.2
        a = 1 + x**2
        b = x * place[0] + place[1]
        root = b**2 - a * (place[0] ** 2 + place[1] ** 2 - radius**2)
        put((b - np.sqrt(root)) / a, 0.6, root > 0)
        # A ball: |ray z - centre| = radius.
        middle, radius = (-0.12, 0.16, 0.6 - forward), 0.11
        a = 1 + x**2 + y**2
        b = x * middle[0] + y * middle[1] + middle[2]
        root = b**2 - a * (sum(part**2 for part in middle) - radius**2)
        put((b - np.sqrt(root)) / a, 0.9, root > 0)
    return DrawnRoom(depth, shade)


def speed(seconds: np.ndarray) -> np.ndarray:
    """Return the forward speed of the moving camera, m/s."""
    return 0.9 * np.sin(2 * math.pi * seconds / 0.8)


def way(seconds: np.ndarray) -> np.ndarray:
    """Return the distance that the moving camera has moved forward, metres."""
    return 0.9 * 0.8 / (2 * math.pi) * (1 - np.cos(2 * math.pi * seconds / 0.8))

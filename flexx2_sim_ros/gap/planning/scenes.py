"""
Scenes that are easy to record, as text and as exact depth.

Each scene is a few flat panels in front of the camera. Depth and reflectivity are computed
analytically, so a scene needs no mesh and no renderer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.physics.geometry import pixel_rays
import numpy as np

Vector = tuple[float, float, float]
_WHITE = 0.85  # reflectivity, assumed
_LARGE = 20.0  # metres, half the side of a wall that fills the image
_WARM = 1800.0  # seconds since power-on


@dataclass(frozen=True)
class Panel:
    """
    A flat rectangle, in the optical frame at the first stamp: x right, y down, z forward, metres.

    `across` and `along` lead from the centre to the middle of two neighbouring sides;
    perpendicular. `reflectivity` is 0 to 1, `velocity` in metres per second.
    """

    centre: Vector
    across: Vector
    along: Vector
    reflectivity: float
    velocity: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PlannedScene:
    """
    A scene to record.

    The camera pans to the right at `turn_rate`, degrees per second. `uptime` is seconds since
    power-on at the first frame.
    """

    panels: tuple[Panel, ...]
    turn_rate: float = 0.0
    uptime: float = _WARM

    @cached_property
    def moving(self) -> bool:
        """Return whether the image changes from frame to frame."""
        return bool(self.turn_rate) or any(any(panel.velocity) for panel in self.panels)


def wall(distance: float, tilt: float = 0.0, reflectivity: float = _WHITE) -> Panel:
    """Return a wall that fills the image; `tilt`, degrees, takes its right side farther away."""
    turn = math.radians(tilt)
    across = (_LARGE * math.cos(turn), 0.0, _LARGE * math.sin(turn))
    return Panel((0.0, 0.0, distance), across, (0.0, _LARGE, 0.0), reflectivity)


def card(
    distance: float, x: float, half: float, reflectivity: float, velocity: Vector = (0.0, 0.0, 0.0)
) -> Panel:
    """Return an upright square with its centre ``x`` metres right of the optical axis."""
    centre = x, 0.0, distance
    return Panel(centre, (half, 0.0, 0.0), (0.0, half, 0.0), reflectivity, velocity)


def render(
    scene: PlannedScene, lens: Intrinsics, stamp: Sequence[float] | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return depth, reflectivity and the visible panel of a scene without noise.

    Depth is float32 metres along the optical axis, NaN where there is no return; reflectivity is
    float32, and the panel uint8, k for the k-th; both are 0 there. All are (H, W), or (T, H, W) of
    a moving scene. `stamp` is (T,) seconds; the scene is as described at the first one.
    """
    seconds = np.asarray(stamp, float)
    seconds = seconds - seconds[0] if scene.moving else np.zeros(1)
    rays = np.concatenate([pixel_rays(lens), np.ones((1, lens.height, lens.width))])
    depth = np.empty((len(seconds), lens.height, lens.width), np.float32)
    visible = np.empty(depth.shape, np.uint8)
    for t, second in enumerate(seconds):
        angle = math.radians(scene.turn_rate * second)
        hits = np.array([_distance(_at_time(one, second, angle), rays) for one in scene.panels])
        depth[t] = hits.min(axis=0)
        visible[t] = np.where(np.isinf(depth[t]), 0, hits.argmin(axis=0) + 1)
    depth[visible == 0] = np.nan
    reflectivity = np.array([0, *(one.reflectivity for one in scene.panels)], np.float32)[visible]
    if scene.moving:
        return depth, reflectivity, visible
    return depth[0], reflectivity[0], visible[0]


def _at_time(panel: Panel, second: float, angle: float) -> np.ndarray:
    # (3, 3) centre, across and along in the frame of a camera that was turned to the right.
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    centre = np.array(panel.centre) + second * np.array(panel.velocity)
    return np.array([centre, panel.across, panel.along]) @ turn.T


def _distance(panel: np.ndarray, rays: np.ndarray) -> np.ndarray:
    # (H, W) depth at which the (3, H, W) rays meet the panel, inf where they do not.
    centre, across, along = panel
    normal = np.cross(across, along)
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = (normal @ centre) / np.tensordot(normal, rays, 1)
        points = depth * rays - centre[:, None, None]
        inside = (
            (depth > 0)
            & (np.abs(np.tensordot(across, points, 1)) <= across @ across)
            & (np.abs(np.tensordot(along, points, 1)) <= along @ along)
        )
    return np.where(inside, depth, np.inf)

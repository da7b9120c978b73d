"""The fixed scene of `flexx2 effects show`, as a camera sees it with one effect and without."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.camera import Camera, flexx2, Frame
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.physics.surface import analyse, Surface
import numpy as np

_WALL, _FLOOR, _SIDE, _FAR = 3.4, 0.42, 1.0, 6.7  # metres: behind, below, right, through the door
_SHADES = 0.9, 0.01  # reflectivity of the chart, left and right
CHART = 1.5  # metres
PANEL = 2.2  # behind it by less than c / 4f, so that mixed phases give a depth in between


@dataclass(frozen=True)
class DrawnRoom:
    """Depth, metres along the optical axis, and reflectivity, 0..1, of the room, (H, W) each."""

    depth: np.ndarray
    reflectivity: np.ndarray


def room(forward: float = 0.0) -> DrawnRoom:
    """
    Return the view of a camera that has moved ``forward``, metres, at most 0.3.

    A bright wall with a door to a far one, a wall at a right angle to it, a floor, a chart of
    gray shades before a panel, a column, and a white ball close by.
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


_FRAMES = 80
STEEP = 40.0  # degrees; at steeper incidence, noise hides the effects


@dataclass(frozen=True)
class EffectView:
    """What a camera saw of the scene in T frames, with an effect and without it."""

    effect: Effect
    scene: DrawnRoom  # from the start of a moving camera
    clean: np.ndarray  # (T, H, W) metres
    surface: Surface  # slopes and edges of `scene`
    seconds: np.ndarray  # (T,)
    frame: Frame  # with the effect
    rest: Frame  # without it, with the same random numbers

    @property
    def kind(self) -> type[Effect]:
        """Return the class of the effect."""
        return type(self.effect)

    @property
    def change(self) -> np.ndarray:
        """Return how much the effect changes each pixel, (T, H, W) mm."""
        return 1e3 * (self.frame.depth - self.rest.depth)

    def calm(self, reach: int, steepest: float = STEEP) -> np.ndarray:
        """Return which pixels are over `reach` px from edges and below an incidence (degrees)."""
        return ~near_edges(self, reach) & (np.degrees(self.surface.incidence) < steepest)

    @property
    def error(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the error of depth with and without the effect, (T, H, W) mm each."""
        with_it, without = (1e3 * (seen.depth - self.clean) for seen in (self.frame, self.rest))
        return with_it, without


def look(effect: Effect) -> EffectView:
    """Simulate the scene with an effect and without it."""
    scene, kind = room(), type(effect)
    spec = kind.picture
    last = (_FRAMES - 1) / 30 if spec.seconds is None else spec.seconds
    seconds = np.linspace(0, last, _FRAMES)
    moves = not kind.changes
    rooms = [room(float(forward)) for forward in way(seconds)] if moves else [scene]
    clean = np.stack([one.depth for one in rooms])
    shade = np.stack([one.reflectivity for one in rooms])
    camera = flexx2()
    matrix = camera.intrinsics.matrix
    frame, rest = (
        Camera(spec.usecase, effects=effects, seed=1).capture(clean, matrix, seconds, shade)
        for effects in ((effect,), ())
    )
    surface = analyse(scene.depth.astype(np.float32), camera.intrinsics, camera.sensor)
    return EffectView(
        effect, scene, np.broadcast_to(clean, frame.depth.shape), surface, seconds, frame, rest
    )


def mean_of_valid(frames: np.ndarray) -> np.ndarray:
    """Return the mean of each pixel over frames, (H, W), where it is valid; NaN if it never is."""
    count = np.isfinite(frames).sum(axis=0)
    mean: np.ndarray = np.nansum(frames, axis=0) / np.where(count, count, np.nan)
    return mean


def deviation_over_time(frames: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each pixel over frames, (H, W); NaN where never valid."""
    return np.sqrt(np.maximum(mean_of_valid(frames**2) - mean_of_valid(frames) ** 2, 0))


def near_edges(view: EffectView, reach: int) -> np.ndarray:
    """Return which pixels are within `reach` pixels of a depth jump, (H, W) bool."""
    near = (view.surface.row_jumps | view.surface.column_jumps).astype(bool)
    for axis in (0, 1):
        wide = near.copy()
        for step in range(1, reach + 1):
            wide |= np.roll(near, step, axis) | np.roll(near, -step, axis)
        near = wide
    return near

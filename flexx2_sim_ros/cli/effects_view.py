"""What a camera sees of the effects' scene, with one effect and without it."""

from dataclasses import dataclass

from flexx2_sim_ros.camera import Camera, flexx2, Frame
from flexx2_sim_ros.cli.effects_scene import DrawnRoom, room, way
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.physics.surface import analyse, Surface
import numpy as np

_FRAMES = 80
STEEP = 40.0  # degrees; at steeper incidence, noise hides the effects


@dataclass(frozen=True)
class EffectView:
    """
    What a camera saw of the scene, with an effect and without it.

    Attributes
    ----------
    effect : Effect
        The effect.
    scene : DrawnRoom
        The scene, from the start of a moving camera.
    clean : numpy.ndarray
        (T, H, W) clean depth, metres.
    surface : Surface
        Slopes and edges of `scene`.
    seconds : numpy.ndarray
        (T,) times of the frames.
    frame, rest : Frame
        T frames with the effect and without it, with the same random numbers.

    """

    effect: Effect
    scene: DrawnRoom
    clean: np.ndarray
    surface: Surface
    seconds: np.ndarray
    frame: Frame
    rest: Frame

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


def mean_over_time(frames: np.ndarray) -> np.ndarray:
    """Return the mean of each pixel over frames, (H, W); NaN for pixels that are never valid."""
    count = np.isfinite(frames).sum(axis=0)
    mean: np.ndarray = np.nansum(frames, axis=0) / np.where(count, count, np.nan)
    return mean


def deviation_over_time(frames: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each pixel over frames, (H, W); NaN where never valid."""
    return np.sqrt(np.maximum(mean_over_time(frames**2) - mean_over_time(frames) ** 2, 0))


def near_edges(view: EffectView, reach: int) -> np.ndarray:
    """Return which pixels are within `reach` pixels of a depth jump, (H, W) bool."""
    near = (view.surface.row_jumps | view.surface.column_jumps).astype(bool)
    for axis in (0, 1):
        wide = near.copy()
        for step in range(1, reach + 1):
            wide |= np.roll(near, step, axis) | np.roll(near, -step, axis)
        near = wide
    return near

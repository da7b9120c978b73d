"""A computed room with many edges, for measurements of speed."""

from itertools import count

from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np

_PERIOD = 33_333_333  # nanoseconds


def room(boxes=12):
    """Return clean depth (172, 224) float32: a wall, a floor and slanted boxes."""
    camera = flexx2().intrinsics
    generator = np.random.default_rng(0)
    v, u = np.mgrid[: camera.height, : camera.width]
    below = np.maximum((v - camera.cy) / camera.fy, 1e-3)
    depth = np.minimum(4.0, 0.35 / below)
    for _ in range(boxes):
        x, y = generator.integers(0, 200), generator.integers(0, 150)
        size = generator.integers(5, 60)
        box = (slice(y, y + size), slice(x, x + size))
        face = generator.uniform(0.8, 3.5) + 0.002 * (u[box] - x)
        depth[box] = np.minimum(depth[box], face)
    return depth.astype(np.float32)


def moving():
    """Return the room at two moments, for effects of motion, and its reflectivity."""
    scene = room()
    shades = np.random.default_rng(1).uniform(0.2, 0.9, scene.shape).astype(np.float32)
    return [scene, scene - np.float32(0.01)], shades


def frames_of(mode, effects, still=False):
    """Return a function that captures the next frame of the moving room, or of one that stands."""
    camera, matrix = Camera(mode, effects=effects, seed=1), flexx2().intrinsics.matrix
    (scenes, shades), ticks = moving(), count()

    def frame():
        tick = next(ticks)
        return camera.capture(scenes[0 if still else tick % 2], matrix, tick * _PERIOD, shades)

    return frame

"""A computed room with many edges, for measurements of speed."""

from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np


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

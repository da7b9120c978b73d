"""A small camera in a scene with an edge, a slant, a hole and a corner."""

from boards import K
from flexx2_sim_ros.camera import Camera
import numpy as np

FIELDS = ('depth', 'sigma', 'amplitude', 'confidence')


def same(one, other):
    """Say whether two frames are equal to the last bit."""
    return all(
        np.array_equal(getattr(one, field), getattr(other, field), equal_nan=True)
        for field in FIELDS
    )


def scenes(count=1):
    """Return (count, 24, 32) metres: an edge, a slant, a hole, a corner; they move on."""
    v, u = np.mgrid[:24, :32].astype(float)
    depth = 1.0 + 0.01 * u
    depth[12:] = np.minimum(depth[12:], 1.0 + 0.08 * (24 - v[12:]))
    depth[6:18, 10:22] = 0.8
    depth[:4, 25:] = np.nan
    return depth + 0.013 * np.arange(count)[:, None, None]


SMALL = K - [[0, 0, 95.5], [0, 0, 73.5], [0, 0, 0]]
SHADES = np.linspace(0.02, 1.0, 32) * np.ones((24, 1))


def capture(effects, clean, stamps, *, seed=3, name='', usecase='Mode_9_30fps'):
    """Return what a new camera sees."""
    return Camera(usecase, effects=effects, seed=seed, name=name).capture(
        clean, SMALL, stamps, SHADES
    )

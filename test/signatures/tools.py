"""What the signatures share: a camera with an effect beside one without, and scenes."""

from dataclasses import replace
import math

from boards import K
from flexx2_sim_ros.camera import Camera, flexx2, NoiseModel
import numpy as np

SPEED_OF_LIGHT = 299_792_458.0
SHAPE = (172, 224)
STEP_5 = 33_333_333
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
RAY_X, RAY_Y = (U - K[0, 2]) / K[0, 0], (V - K[1, 2]) / K[1, 1]
_NONE = NoiseModel(0.0, 0.0, 0.0, 0.0, 2.7, 0.0)
QUIET = replace(flexx2(), modes=tuple(replace(mode, noise=_NONE) for mode in flexx2().modes))
SIGNATURES = {}


def signature(function):
    """Register the signature of the effect that the function is named after."""
    SIGNATURES[function.__name__] = function
    return function


def pair(
    name, clean, stamp=0, reflectivity=None, *, usecase='Mode_5_30fps', profile=None, **parameters
):
    """Return what a camera with an effect and one without it see."""
    with_it, without = (
        Camera(usecase, profile=profile, effects=effects, seed=7).capture(
            clean, K, stamp, reflectivity
        )
        for effects in ({name: parameters}, ())
    )
    return with_it, without


def shift(name, clean, stamp=0, reflectivity=None, **options):
    """Return by how much an effect changes depth, metres."""
    with_it, without = pair(name, clean, stamp, reflectivity, **options)
    return with_it.depth.astype(np.float64) - without.depth


def spread(name, clean, reflectivity=None, frames=60, **options):
    """Return the errors of a still scene, with the effect and without, mm; (T, H, W)."""
    stamps = np.arange(frames)
    return tuple(
        (frame.depth.astype(np.float64) - clean) * 1e3
        for frame in pair(name, clean, stamps, reflectivity, **options)
    )


def wave_number(frequency=60e6):
    """Return radians a metre of depth."""
    return 4 * math.pi * frequency / SPEED_OF_LIGHT


def close(found, wanted, rel=0.15, within=0.0):
    """Assert that all are within 15 % of what is wanted."""
    np.testing.assert_allclose(found, wanted, rtol=rel, atol=within)


def ramp(near, far):
    """Return distances that grow from left to right, without jumps."""
    return np.broadcast_to(np.linspace(near, far, SHAPE[1]), SHAPE)


def wall(distance):
    return np.full(SHAPE, distance)


def step(near, far):
    return np.where(U < 112, near, far)

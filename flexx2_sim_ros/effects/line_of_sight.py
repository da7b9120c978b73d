"""The ray of each pixel: how much light it brings, its length, and shifts along it."""

from flexx2_sim_ros.physics.frame_state import FrameState
from flexx2_sim_ros.physics.geometry import ray_length
import numpy as np


def log_amplitude(amplitude: np.ndarray) -> np.ndarray:
    """Return the natural logarithm of an amplitude in 1/m^2, float32; that of 1e-30 for none."""
    return np.log(np.maximum(amplitude, np.float32(1e-30)))


def ranges(state: FrameState) -> np.ndarray:
    """Return the range of each pixel with all that has been added so far, (H, W) float32 m."""
    depth = state.depth.copy()
    for weight, shift in zip(state.weights, state.shifts, strict=True):
        depth += np.float32(weight) * shift
    return depth * ray_length(state.intrinsics.matrix, depth.shape)


def add_along_ray(state: FrameState, strength: float, metres: np.ndarray) -> None:
    """Add metres of range, (H, W) or one number, times a strength, at every frequency."""
    length = ray_length(state.intrinsics.matrix, state.depth.shape)
    state.add_shift(np.float32(strength) * metres / length)

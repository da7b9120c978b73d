"""A simple NumPy implementation of the noise, to compare speed only."""

from flexx2_sim_ros.profiles.modes import Mode
import numpy as np


def straightforward(
    depth: np.ndarray, fx: float, fy: float, mode: Mode, generator: np.random.Generator
) -> np.ndarray:
    """
    Add sigma_z(z, theta) after shifting every pixel by a Gaussian offset of its own.

    Measured by the procedure of the paper, its edges move too little and its slanted surfaces are
    too noisy.
    """
    noise = mode.noise
    height, width = depth.shape
    dzdv, dzdu = np.gradient(depth)
    theta = np.arctan(np.hypot(dzdu * fx / depth, dzdv * fy / depth))
    theta = np.minimum(theta, np.float32(1.48))
    sigma = (
        noise.a
        + noise.b * depth
        + noise.c * depth**2
        + noise.d * depth ** np.float32(noise.n) * (theta / (np.pi / 2 - theta)) ** 2
    )
    shift = np.rint(generator.standard_normal((height, width), np.float32) * noise.sigma_x)
    columns = np.clip(np.arange(width) - shift.astype(np.int32), 0, width - 1)
    seen = np.take_along_axis(depth, columns, axis=1)
    out = seen + sigma * generator.standard_normal((height, width), np.float32)
    out[(out < mode.range_min) | (out > mode.range_max)] = np.nan
    return out

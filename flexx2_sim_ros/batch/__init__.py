"""
Thousands of cameras at once, for reinforcement learning: the model as Warp kernels.

torch and JAX are used when their arrays are passed, and imported by whoever passes them.
"""

try:
    import warp  # noqa: F401
except ImportError as error:
    raise ImportError('flexx2_sim_ros.batch needs warp-lang: pip install warp-lang') from error

from flexx2_sim_ros.batch.camera import BatchCamera
from flexx2_sim_ros.batch.noise import depth_noise, DepthNoise
from flexx2_sim_ros.batch.terms import noisy_depth

__all__ = ['BatchCamera', 'DepthNoise', 'depth_noise', 'noisy_depth']

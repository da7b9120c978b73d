"""The noise of a camera, written as parameters of mappers and simulators."""

from flexx2_sim_ros.export.noise import measure_noise, Noise
from flexx2_sim_ros.export.target import Parameters, Target
from flexx2_sim_ros.export.targets import TARGETS

__all__ = ['TARGETS', 'Noise', 'Parameters', 'Target', 'measure_noise']

"""The camera model: modes, geometry, noise. No ROS in here."""

from flexx2_sim_ros.camera.intrinsics import Intrinsics
from flexx2_sim_ros.camera.modes import flexx2, Mode, NoiseModel, Profile
from flexx2_sim_ros.camera.pipeline import Camera, Frame

__all__ = ['Camera', 'Frame', 'Intrinsics', 'Mode', 'NoiseModel', 'Profile', 'flexx2']

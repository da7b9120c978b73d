"""The camera model: modes, geometry, noise. No ROS in here."""

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.frame import Frame
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2, Mode, NoiseModel, Profile

__all__ = ['Camera', 'Frame', 'Intrinsics', 'Mode', 'NoiseModel', 'Profile', 'flexx2']

"""The camera model: modes, geometry, noise. No ROS in here."""

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.frame import Frame
from flexx2_sim_ros.physics.geometry import depth_from_z_buffer, ray_length
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2, Mode, NoiseModel, Profile

__all__ = [
    'Camera',
    'Frame',
    'Intrinsics',
    'Mode',
    'NoiseModel',
    'Profile',
    'depth_from_z_buffer',
    'flexx2',
    'ray_length',
]

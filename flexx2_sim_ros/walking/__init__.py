"""
Walks over terrain with footholds that are chosen on the height grid that the cameras see.

The walk is kinematic: the footholds are judged by geometry, forces are not simulated.
"""

from flexx2_sim_ros.walking.cameras import ExactCamera, SimulatedCamera
from flexx2_sim_ros.walking.terrain import KINDS
from flexx2_sim_ros.walking.walks import Point, walk

__all__ = ['KINDS', 'ExactCamera', 'Point', 'SimulatedCamera', 'walk']

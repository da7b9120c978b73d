"""
Ground truth for real recordings: where the camera was, and what it should have measured.

`make_truth` registers recordings to a room (a mesh or a MuJoCo model) for a `RoomRequest`. Poses
are fitted together with the errors that all recordings share, so that the poses do not hide them.
For a `BoardRequest` it finds a printed board in gray images; a `PlaneRequest` needs some planes of
the room and what was measured of them.
"""

from flexx2_sim_ros.truth.campaign import make_truth
from flexx2_sim_ros.truth.from_planes import asked_for
from flexx2_sim_ros.truth.run import BoardRequest, PlaneRequest, RoomRequest
from flexx2_sim_ros.truth.trajectory import PoseSource

__all__ = ['BoardRequest', 'PlaneRequest', 'PoseSource', 'RoomRequest', 'asked_for', 'make_truth']

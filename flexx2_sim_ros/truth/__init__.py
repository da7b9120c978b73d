"""
Ground truth for real recordings: where the camera was, and what it should have measured.

`make_truth` registers recordings to a room (a mesh or a MuJoCo model). Poses are fitted together
with the errors that all recordings share, so that the poses do not hide them. `make_board_truth`
finds a printed target in gray images instead; `make_plane_truth` needs some planes of the room and
what was measured of them.
"""

from flexx2_sim_ros.truth.board_campaign import BoardRequest, make_board_truth
from flexx2_sim_ros.truth.campaign import make_truth, RoomRequest
from flexx2_sim_ros.truth.plane_campaign import asked_for, make_plane_truth, PlaneRequest
from flexx2_sim_ros.truth.trajectory import PoseSource

__all__ = [
    'BoardRequest',
    'PlaneRequest',
    'PoseSource',
    'RoomRequest',
    'asked_for',
    'make_board_truth',
    'make_plane_truth',
    'make_truth',
]

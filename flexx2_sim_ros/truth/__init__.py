"""
Ground truth for real recordings: where the camera was, and what it should have measured.

`make_truth` registers recordings to a room (a mesh or a MuJoCo model). Poses are fitted together
with the errors that all recordings share, so that the poses do not hide them. `make_board_truth`
finds a printed target in gray images instead.
"""

from flexx2_sim_ros.truth.board_campaign import BoardRequest, make_board_truth
from flexx2_sim_ros.truth.campaign import make_truth, Request

__all__ = ['BoardRequest', 'Request', 'make_board_truth', 'make_truth']

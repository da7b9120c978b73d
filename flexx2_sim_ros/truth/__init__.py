"""
Ground truth for real recordings: where the camera was, and what it should have measured.

In come recordings and surfaces that are known: a room (mesh or MuJoCo model), a printed board, or
planes that were measured. Out go the same recordings with ``clean_depth`` and its accuracy,
``truth.yaml`` and a page. Start at `make_truth` in ``campaign.py``: it observes, places, solves
and writes; `from_room`, `from_board` and `from_planes` are its sources of surfaces.
"""

from flexx2_sim_ros.truth.campaign import make_truth
from flexx2_sim_ros.truth.from_planes import asked_for
from flexx2_sim_ros.truth.run import BoardRequest, PlaneRequest, RoomRequest
from flexx2_sim_ros.truth.trajectory import PoseSource

__all__ = ['BoardRequest', 'PlaneRequest', 'PoseSource', 'RoomRequest', 'asked_for', 'make_truth']

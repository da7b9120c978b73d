"""
Ground truth for real recordings: where the camera was, and what it should have measured.

`make_truth` registers recordings to a room (a mesh or a MuJoCo model). Poses are fitted together
with the errors that all recordings share, so that the poses do not hide them.
"""

from flexx2_sim_ros.truth.campaign import make_truth, Request

__all__ = ['Request', 'make_truth']

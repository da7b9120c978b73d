"""
The paper's measurement as a library: from recordings of a board to a camera profile.

`capture` says what to record and records it with the simulated camera, `analysis` measures a
folder of recordings and fits the noise model, `assumptions` holds them against what the model
takes for granted, `new_profile` makes a camera profile of it and `noise_report` a page. No ROS.
"""

from flexx2_sim_ros.characterize.analysis import Characterization, characterize, ModeResult
from flexx2_sim_ros.characterize.assumptions import check_assumptions, TestedAssumption
from flexx2_sim_ros.characterize.new_profile import to_profile

__all__ = [
    'Characterization',
    'TestedAssumption',
    'ModeResult',
    'characterize',
    'check_assumptions',
    'to_profile',
]

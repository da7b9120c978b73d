"""
Diagnose the gap between recordings of a real camera and the simulation of the same scenes.

`diagnose` says where the two differ, which effects explain it, and how much of the gap goes away
on recordings that were not used to decide. `check` says whether this holds on recordings that the
diagnosis has never seen. `cost` says what the gap means for what reads depth on a robot. `measure`
says how much of a gap given effects take off. `randomise` makes distributions of the effects.
"""

from flexx2_sim_ros.gap.check import check
from flexx2_sim_ros.gap.cost import cost
from flexx2_sim_ros.gap.diagnosis import diagnose
from flexx2_sim_ros.gap.given_effects import measure
from flexx2_sim_ros.gap.randomise import randomise

__all__ = ['check', 'cost', 'diagnose', 'measure', 'randomise']

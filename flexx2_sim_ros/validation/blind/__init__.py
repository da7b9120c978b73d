"""
A blind camera: raw correlation samples, effects on phasors and taps.

It takes the place of a real camera in tests of the diagnosis. Therefore it uses neither the
models of the catalogue nor the diagnosis. It shares with them only the modes, the intrinsics and
the sigma of the base model. ``docs/blind_camera.md`` describes its effects.
"""

from flexx2_sim_ros.validation.blind.campaign import BlindCamera, Case
from flexx2_sim_ros.validation.blind.catalogue import CATALOGUE, NOVEL
from flexx2_sim_ros.validation.blind.internals import Internals, VARIED
from flexx2_sim_ros.validation.blind.scene_set import SceneKey, SceneSet

__all__ = [
    'CATALOGUE',
    'NOVEL',
    'BlindCamera',
    'VARIED',
    'Case',
    'Internals',
    'SceneKey',
    'SceneSet',
]

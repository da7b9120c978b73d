"""
A blind camera: raw correlation samples, effects on phasors and taps.

It stands for a real camera when the diagnosis is put to the test, so it knows nothing of the
catalogue's models and nothing of the diagnosis; with them it shares the modes, the intrinsics and
the base model's sigma alone. What each effect does: ``docs/blind_camera.md``.
"""

from flexx2_sim_ros.validation.blind.campaign import BlindCamera, Case
from flexx2_sim_ros.validation.blind.catalogue import CATALOGUE, NOVEL
from flexx2_sim_ros.validation.blind.scene_set import SceneKey, SceneSet

__all__ = ['CATALOGUE', 'NOVEL', 'BlindCamera', 'Case', 'SceneKey', 'SceneSet']

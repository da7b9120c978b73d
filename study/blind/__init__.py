"""
A blind camera: raw correlation samples, effects on phasors and taps.

It takes the place of a real camera in tests of the diagnosis. Therefore it uses neither the
models of the catalogue nor the diagnosis. It shares with them only the modes, the intrinsics and
the sigma of the base model. ``docs/benchmark.md`` describes it.
"""

from study.blind.campaign import BlindCamera, Case
from study.blind.catalogue import CATALOGUE, NOVEL
from study.blind.internals import Internals, VARIED
from study.blind.scene_set import SceneKey, SceneSet

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

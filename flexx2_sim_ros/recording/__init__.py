"""
Recordings: the project's exchange format.

A recording is a NumPy archive (``.npz``) of plain arrays, never pickled:

=============== =================== ======== ============================================
key             shape               dtype    meaning
=============== =================== ======== ============================================
``depth``       (T, H, W)           float32  metres along the optical axis, NaN if invalid
``clean_depth`` (H, W) or (T, H, W) float    what is really there, NaN for nothing
``K``           (3, 3)              float64  camera matrix, pixels
``stamp``       (T,)                float64  seconds
``usecase``     ()                  str      the camera's mode
=============== =================== ======== ============================================

plus whatever else came with the scene (``reflectivity`` (H, W) or (T, H, W) in 0..1, for one).
A *scene* is the same without ``depth`` and ``usecase``, and ``stamp`` is optional.
"""

from flexx2_sim_ros.recording.npz import load_scene, RecordingWriter, Scene

__all__ = ['RecordingWriter', 'Scene', 'load_scene']

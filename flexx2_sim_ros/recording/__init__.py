"""
Recordings: the project's exchange format.

A recording is a NumPy archive (``.npz``) of plain arrays, never pickled:

=============== =================== ======== ============================================
key             shape               dtype    meaning
=============== =================== ======== ============================================
``depth``       (T, H, W)           float32  metres along the optical axis, NaN if invalid
``clean_depth`` (H, W) or (T, H, W) float    ground truth, NaN where there is no return
``K``           (3, 3)              float64  camera matrix, pixels
``stamp``       (T,)                float64  seconds
``stamp_ns``    (T,)                int64    nanoseconds, where ``stamp`` cannot hold them
``usecase``     ()                  str      the camera's mode
``amplitude``   (T, H, W)           uint8    the gray image, where it was recorded
=============== =================== ======== ============================================

plus how well `clean_depth` is known (`flexx2_sim_ros.recording.truth`)
and whatever else came with the scene (``reflectivity`` (H, W) or (T, H, W) in 0..1, for one).
A *scene* is the same without ``depth`` and ``usecase``, and ``stamp`` is optional.

The same recording can lie in a rosbag2 bag: `load_recording` reads either, `open_recording`
reads either in bounded memory, and `flexx2_sim_ros.recording.convert` goes between them.
"""

from flexx2_sim_ros.recording.npz import load_scene, RecordingWriter, Scene
from flexx2_sim_ros.recording.opening import load_recording, open_recording, recording_cameras
from flexx2_sim_ros.recording.reader import Recording, RecordingReader

__all__ = [
    'Recording',
    'RecordingReader',
    'RecordingWriter',
    'Scene',
    'load_recording',
    'load_scene',
    'open_recording',
    'recording_cameras',
]

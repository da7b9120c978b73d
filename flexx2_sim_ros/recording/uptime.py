"""The time since power-on that a recording says."""

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.reader import RecordingReader
import numpy as np


def uptime_of(reader: RecordingReader) -> np.ndarray | None:
    """
    Return (T,) seconds since power-on of each frame, as the recording says; None if it does not.

    Raises InputError when `uptime` is not one number or one for each frame.
    """
    uptime = reader.arrays.get('uptime')
    if uptime is None:
        return None
    if uptime.dtype.kind not in 'fiu' or uptime.shape not in ((), (len(reader.stamp),)):
        raise InputError(
            f'{reader.path}: uptime: must be seconds since power-on ({len(reader.stamp)},), '
            f'got {uptime.dtype} of shape {uptime.shape}'
        )
    since = 0.0 if uptime.ndim else (reader.stamp_ns - reader.stamp_ns[0]) / 1e9
    return np.asarray(uptime + since, float)

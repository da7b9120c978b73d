"""The time since power-on of recordings that do not say it, from their stamps."""

from collections.abc import Sequence

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import RecordingReader
from flexx2_sim_ros.recording.uptime import uptime_of
import numpy as np

_LONGEST = 24 * 3600.0  # seconds: recordings farther apart are not of one session


def uptimes(
    readers: Sequence[RecordingReader], first: float | None = None
) -> list[np.ndarray | None]:
    """
    Return the time since power-on of each recording, from stamps of one clock.

    A bag does not say when the camera was switched on. An error that decays with time looks the
    same from any moment on, but for its size, so without `first` the time is counted from the
    earliest recording.

    Parameters
    ----------
    readers : sequence of RecordingReader
        The recordings of one session: the camera was not switched off in between.
    first : float, optional
        Seconds from power-on to the first frame of the earliest recording; `InputError` where it
        cannot be used.

    Returns
    -------
    list of numpy.ndarray or None
        (T,) seconds for each recording: those that it says itself, where one of them does. None
        where nothing is known: the stamps are not of one clock and one session.

    """
    if not readers:
        return []
    own = [uptime_of(reader) for reader in readers]
    if any(one is not None for one in own):
        if first is not None:
            raise InputError('--uptime: must not be given where recordings have the key uptime')
        return own
    stamps = sorted((reader.stamp_ns for reader in readers), key=lambda stamp: int(stamp[0]))
    begin = stamps[0][0]
    apart = all(one[-1] < other[0] for one, other in zip(stamps, stamps[1:], strict=False))
    together = (stamps[-1][-1] - begin) / 1e9 < _LONGEST
    if not (apart and together):
        if first is not None:
            raise InputError(
                '--uptime: must be given for recordings of one session and one clock, got '
                + ('more than a day between two of them' if apart else 'stamps that overlap')
            )
        return own
    return [(reader.stamp_ns - begin) / 1e9 + (first or 0.0) for reader in readers]

"""How old images are when they arrive, by the times at which they were received."""

from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.data import READING
from flexx2_sim_ros.recording.reader import RecordingReader
import numpy as np


@dataclass(frozen=True)
class Arrival:
    """
    Seconds from the stamp of a frame to its arrival, over the frames of a recording.

    5 % of the frames are below `low`, and 5 % above `high`.
    """

    median: float
    low: float
    high: float


def find_arrival(reader: RecordingReader, notes: list[str]) -> Arrival | None:
    """
    Return how late the frames of a recording arrived; None where the recording does not say.

    It is also None where the times are of another clock than the stamps, with a note in `notes`:
    the median is negative or above a second.
    """
    received = reader.received_ns
    if received is None:
        return None
    late = (received - reader.stamp_ns) / 1e9
    low, median, high = (float(value) for value in np.quantile(late, READING.arrivals))
    if 0 <= median <= READING.longest_delay:
        return Arrival(median, low, high)
    notes.append(
        f'{reader.path}: received: not used: its clock is not that of stamp, the median '
        f'difference is {median:.3g} s'
    )
    return None

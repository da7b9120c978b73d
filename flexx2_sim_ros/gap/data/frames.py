"""The frames of a recording: which are compared, what is known of them, how late they arrive."""

from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.gap.calibration.data import READING, REGISTRATION
from flexx2_sim_ros.physics.surface import analyse, Surface
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.sensor import Sensor
from flexx2_sim_ros.recording.reader import RecordingReader
from flexx2_sim_ros.recording.truth import Truth
import numpy as np

MOST_FRAMES, _SEGMENT = READING.most_frames, READING.segment


def choose_frames(count: int, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Choose the frames of a recording that the diagnosis reads; more are read of small images.

    Return the indices of the chosen frames; and for each whether it starts a segment, so that it
    does not follow the chosen frame before it.
    """
    if count <= max(MOST_FRAMES, min(READING.most_small, READING.pixels // (height * width))):
        fresh = np.zeros(count, bool)
        fresh[:1] = True
        return np.arange(count), fresh
    starts = np.linspace(0, count - _SEGMENT, MOST_FRAMES // _SEGMENT).astype(int)
    chosen = np.unique(np.concatenate([np.arange(s, s + _SEGMENT) for s in starts]))
    fresh = np.ones(len(chosen), bool)
    fresh[1:] = np.diff(chosen) != 1
    return chosen, fresh


def looked_at(count: int, still: bool) -> list[int]:
    """Return which of so many frames errors are looked at in: one if the scene stands still."""
    if still:
        return [0]
    first = min(REGISTRATION.lead, count - 1)
    return sorted({round(x) for x in np.linspace(first, count - 1, REGISTRATION.frames)})


def at_frame(images: Any, t: Any) -> Any:
    """Return the image of a frame, or those of several, where each has its own, else `images`."""
    return images if images is None or images.ndim < 3 else images[t]


def seen_at(depth: np.ndarray, t: int, still: bool) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what (T, H, W) depth shows of a frame, or the mean over all frames of a still scene.

    It is (H, W) metres, NaN where fewer than half of the frames are valid; beside it (H, W) how
    many are, at least one.
    """
    if not still:
        return depth[t], np.ones(depth.shape[1:])
    valid = np.isfinite(depth).sum(axis=0)
    count = np.maximum(valid, 1)
    return np.where(valid > 0.5 * len(depth), np.nansum(depth, axis=0) / count, np.nan), count


def surface_of(clean: np.ndarray, K: np.ndarray, sensor: Sensor) -> Surface:
    """Return jumps and incidence of a clean image, (H, W) metres."""
    lens = Intrinsics.from_matrix(K, clean.shape[1], clean.shape[0])
    return analyse(np.ascontiguousarray(clean), lens, sensor)


def of_frames(truth: Truth, chosen: np.ndarray) -> Truth:
    """Return the truth of chosen frames; a mask without unknown pixels is dropped."""
    known, sigma = (at_frame(one, chosen) for one in (truth.known, truth.clean_sigma))
    return replace(truth, known=None if known is None or known.all() else known, clean_sigma=sigma)


def known_in(frames: np.ndarray, clean: np.ndarray, truth: Truth) -> Truth:
    """Return a truth that is unknown outside of (T,) bool `frames`; `clean` is (T, H, W)."""
    if frames.all():
        return truth
    known = np.broadcast_to(frames[:, None, None], clean.shape)
    return replace(truth, known=known if truth.known is None else known & truth.known)


def first_known(clean: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    """Return (H, W) the first known clean depth of each pixel, of (T, H, W) frames."""
    # A pixel that is unknown in the first frame may stand still all the same.
    if known is None or known.ndim < 3:
        return np.asarray(clean[0])
    return np.take_along_axis(clean, known.argmax(axis=0)[None], axis=0)[0]


def still(truth: Truth, there: np.ndarray) -> Truth:
    """
    Return the truth of one image for a still scene.

    A pixel is known if all frames know it that have a clean image, (T,) `there`. Its sigma is the
    largest of all frames.
    """
    known, sigma = truth.known, truth.clean_sigma
    return replace(
        truth,
        known=known[there].all(axis=0) if known is not None and known.ndim == 3 else known,
        clean_sigma=sigma.max(axis=0) if sigma is not None and sigma.ndim == 3 else sigma,
    )


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

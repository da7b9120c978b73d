"""The offset between the clock of recordings and that of given poses, from how fast both move."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

from flexx2_sim_ros.truth.solver import robust_sigma
import numpy as np
from scipy.spatial.transform import Rotation

_WINDOW = 0.1  # seconds over which motions are compared
_REACH = 1.0  # seconds around the told offset that are tried
_STEP, _MOST_STEPS = 0.005, 20_000  # seconds between two offsets that are tried; how many
_FINE = 0.001  # seconds
_LEAST_NOISE = np.array([math.radians(0.02), 0.0003])  # of a motion: radians, metres
_LEAST_MOTION = np.array([math.radians(0.1), 0.002])  # smaller changes of speed are noise
_LEAST_FRAMES = 8
_LEAST_OVERLAP = 0.8  # fraction of the frames at which there are poses
_MOST_MISFIT = 0.3  # of the variance of the motions
_RIVAL = 2.0  # times the misfit of the best offset
MOST_DEVIATION = 0.010  # seconds: a camera at 0.5 m/s is then 5 mm off

# Returns (T, 7) poses at (T,) int64 stamps, NaN where there are none; see `Trajectory.at`.
Poses = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ClockOffset:
    """An offset between two clocks, with the latency of the images."""

    seconds: float = 0.0  # stamps of the recording minus stamps of the poses
    deviation: float = math.inf  # standard deviation, seconds
    reason: str = ''  # why it cannot be trusted, empty if it can


def find_offset(
    stamp_ns: np.ndarray, fitted: Poses, told: Poses, span_ns: tuple[int, int], middle: float
) -> ClockOffset:
    """
    Find the offset at which given poses turn and move as the fitted ones do.

    Offsets within a second of `middle`, seconds, are tried; if the poses share no time with the
    recording there, all at which they do. `stamp_ns` is (T,) int64 stamps of the frames; `fitted`
    gives poses of the camera by these, `told` those given by their own stamps, of which `span_ns`
    is the first and the last.
    """
    seen = _motions(fitted, stamp_ns)
    good = np.isfinite(seen).all(axis=1)
    if good.sum() < _LEAST_FRAMES:
        return ClockOffset(reason=f'needs at least {_LEAST_FRAMES} frames that move')
    seen, times = seen[good], (stamp_ns[good] - stamp_ns[0]) / 1e9
    speed = np.maximum(seen.std(axis=0), _LEAST_MOTION)
    # Seconds from the first frame: nanoseconds since 1970 are too large for float64.
    first, last = ((stamp - int(stamp_ns[0])) / 1e9 for stamp in span_ns)
    low, high = middle - _REACH, middle + _REACH
    if high < times[0] - last or low > times[-1] - first:
        low, high = times[0] - last, times[-1] - first
    grid = np.arange(max(first, times[0] - high), min(last, times[-1] - low) + _STEP, _STEP)
    given = _motions(told, int(stamp_ns[0]) + np.rint(grid * 1e9).astype(np.int64))
    model = _Model(grid, given, times, seen, speed)
    tried = np.linspace(low, high, min(int((high - low) / _STEP) + 1, _MOST_STEPS))
    misfits = model.misfits(tried)
    if not np.isfinite(misfits).any():
        return ClockOffset(reason='the poses share too little time with the recording')
    best = float(tried[np.nanargmin(misfits)])
    finer = best + np.arange(-2 * _STEP, 2 * _STEP + _FINE, _FINE)
    fine = model.misfits(finer)
    best, least = float(finer[np.nanargmin(fine)]), float(np.nanmin(fine))
    deviation, reason = model.deviation(best), ''
    others = misfits[np.abs(tried - best) > 2 * _WINDOW]
    if deviation > MOST_DEVIATION:
        reason = (
            f'the camera moves too evenly: it is known to {deviation * 1e3:.0f} ms (must be '
            f'{MOST_DEVIATION * 1e3:.0f} ms)'
        )
    elif least > _MOST_MISFIT:
        reason = 'the given poses do not move as the camera does'
    elif min(best - low, high - best) < 2 * _STEP:
        reason = f'it must be within {_REACH:g} s of the offset given'
    elif len(others) and np.nanmin(others, initial=np.inf) < _RIVAL * least:
        reason = 'another offset fits nearly as well'
    return ClockOffset(best, deviation, reason)


@dataclass(frozen=True)
class _Model:
    # Motions of the given poses on a grid of times, and those of the frames: times in seconds from
    # the first frame in either clock, (N, 2) radians and metres; how much the speed changes.
    grid: np.ndarray
    given: np.ndarray
    times: np.ndarray
    seen: np.ndarray
    speed: np.ndarray

    def at(self, offset: float) -> np.ndarray:
        # (N, 2) motions of the given poses at the frames; NaN where there are none.
        there = self.times - offset
        out = [np.interp(there, self.grid, part, np.nan, np.nan) for part in self.given.T]
        return np.stack(out, axis=1)

    def misfits(self, offsets: np.ndarray) -> np.ndarray:
        # Mean squared difference of the motions in units of their variance; NaN without overlap.
        out = np.full(len(offsets), np.nan)
        for i, offset in enumerate(offsets):
            squares = (((self.at(offset) - self.seen) / self.speed) ** 2).mean(axis=1)
            there = np.isfinite(squares)
            if there.mean() >= _LEAST_OVERLAP:
                out[i] = squares[there].mean()
        return out

    def deviation(self, offset: float) -> float:
        # From the slopes of the motions and what is left. Windows overlap, so that not every frame
        # counts.
        left = self.at(offset) - self.seen
        noise = np.maximum(robust_sigma(left, axis=0), _LEAST_NOISE)
        slope = (self.at(offset + _STEP) - self.at(offset - _STEP)) / (2 * _STEP)
        information = float(np.nansum((slope / noise) ** 2))
        windows = max(_WINDOW * (len(self.times) - 1) / max(np.ptp(self.times), 1e-9), 1.0)
        return math.sqrt(windows / information) if information > 0 else math.inf


def _motions(poses: Poses, stamp_ns: np.ndarray) -> np.ndarray:
    # (T, 2) angle and distance from half a window before to half a window after each stamp. They
    # do not depend on the frame of the poses, nor (as for angles) on where the camera is mounted.
    half = round(_WINDOW / 2 * 1e9)
    before, after = poses(stamp_ns - half), poses(stamp_ns + half)
    out = np.full((len(stamp_ns), 2), np.nan)
    good = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    if good.any():
        turn = Rotation.from_quat(before[good, 3:]).inv() * Rotation.from_quat(after[good, 3:])
        out[good, 0] = turn.magnitude()
        out[good, 1] = np.linalg.norm(after[good, :3] - before[good, :3], axis=1)
    return out


def common_offset(offsets: Sequence[ClockOffset]) -> ClockOffset:
    """Return the offset that recordings agree on, at least one: their weighted mean."""
    good = [one for one in offsets if not one.reason]
    if not good:
        return offsets[0]
    weights = np.array([one.deviation**-2.0 for one in good])
    values = np.array([one.seconds for one in good])
    mean = float(weights @ values / weights.sum())
    apart = float(np.abs(values - mean).max())
    deviation = max(float(weights.sum() ** -0.5), float(values.std() / math.sqrt(len(good))))
    reason = ''
    if apart > 2 * MOST_DEVIATION:
        reason = f'recordings disagree by {apart * 1e3:.0f} ms'
    return ClockOffset(mean, deviation, reason)

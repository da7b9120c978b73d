"""Decide whether the pose of a recording can be trusted: used, doubtful or refused, and why."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.truth.alignment import residuals
from flexx2_sim_ros.truth.joint import Solution
from flexx2_sim_ros.truth.meshes import load_room
from flexx2_sim_ros.truth.registration import Registered
import numpy as np

# A pixel fits if its residual is at most this many metres and standard deviations.
_FITS, _FITS_NOISE = 0.05, 3.0
_LEAST_FITTING = 0.6
FITTING = 0.8
_RIVAL = 1.3  # times the cost of the best pose
_MOST_METRES, _MOST_DEGREES = 0.01, 0.5  # standard deviation of a pose
_TOLD = 0.3, 20.0  # metres and degrees that a given pose may be wrong by
_OUTLYING, _OUTLYING_METRES = 3.0, 0.01  # times the usual median residual; metres

_LOST = 'the camera is lost: none of the frames that were tried fits the room'


@dataclass(frozen=True)
class Verdict:
    """
    How well a recording fits the room.

    Attributes
    ----------
    state : str
        ``used``, ``doubtful`` or ``refused``.
    reasons : tuple of str
        Why it is doubtful or refused.
    fitting : float
        Fraction of its pixels that fit the room.
    residual : float
        Median of the absolute residual, metres.
    deviation : tuple of float
        Standard deviation of the pose along and about its least certain axis: metres, degrees.

    """

    state: str
    reasons: tuple[str, ...]
    fitting: float
    residual: float
    deviation: tuple[float, float]


def judge(registered: Sequence[Registered], solution: Solution) -> list[Verdict]:
    """
    Judge all recordings.

    Parameters
    ----------
    registered : sequence of Registered
        Registrations, by number of the recording.
    solution : Solution
        The solution, with views of all recordings.

    Returns
    -------
    list of Verdict

    """
    numbers = [_numbers(i, solution) for i in range(len(registered))]
    seen = {view.recording for view in solution.views}
    usual = float(np.median([numbers[i][1] for i in sorted(seen)])) if seen else 0.0
    out = []
    for i, (one, (fitting, residual, deviation)) in enumerate(
        zip(registered, numbers, strict=True)
    ):
        refused, doubts = [], []
        if i not in seen:
            out.append(Verdict('refused', (_LOST,), fitting, residual, deviation))
            continue
        if one.told is not None and (one.told[0] > _TOLD[0] or one.told[1] > _TOLD[1]):
            refused.append(
                f'its pose is {one.told[0]:.2f} m and {one.told[1]:.0f} degrees from the given '
                f'one, which may be off by {_TOLD[0]:g} m and {_TOLD[1]:g} degrees'
            )
        if fitting < _LEAST_FITTING:
            refused.append(f'only {fitting:.0%} of its pixels fit the room')
        elif fitting < FITTING:
            doubts.append(f'only {fitting:.0%} of its pixels fit the room')
        if one.rival < _RIVAL * min(one.costs):
            doubts.append('another pose fits nearly as well')
        if deviation[0] > _MOST_METRES or deviation[1] > _MOST_DEGREES:
            doubts.append(
                f'what it sees does not hold its pose: {deviation[0] * 1e3:.0f} mm and '
                f'{deviation[1]:.1f} degrees along the worst axes'
            )
        if len(seen) > 2 and residual > max(_OUTLYING * usual, _OUTLYING_METRES):
            doubts.append(
                f'its residual is {residual * 1e3:.0f} mm, that of most is {usual * 1e3:.0f} mm'
            )
        state = 'refused' if refused else 'doubtful' if doubts else 'used'
        out.append(Verdict(state, tuple(refused + doubts), fitting, residual, deviation))
    return out


def _numbers(recording: int, solution: Solution) -> tuple[float, float, tuple[float, float]]:
    left, fits, spread = [], [], np.zeros((6, 6))
    views = [i for i, view in enumerate(solution.views) if view.recording == recording]
    for i in views:
        view = solution.views[i]
        columns, values = solution.columns, solution.values
        rays = columns.true_rays(values, view.target.rays)
        hits = load_room(view.room).cast(view.pose, rays)
        error = residuals(hits, view.target)
        error -= columns.errors(values, hits, rays, view.bounce, view.uptime)
        with np.errstate(invalid='ignore'):
            fits.append(np.abs(error) < _FITS + _FITS_NOISE * view.target.sigma)
        left.append(np.abs(error[np.isfinite(error)]))
        spread += solution.covariances[i] / len(views)
    if not views or not sum(map(len, fits)):
        return 0.0, float('inf'), (float('inf'), float('inf'))
    metres = float(np.sqrt(np.linalg.eigvalsh(spread[:3, :3])[-1]))
    degrees = float(np.degrees(np.sqrt(np.linalg.eigvalsh(spread[3:, 3:])[-1])))
    every = np.concatenate(left)
    residual = float(np.median(every)) if len(every) else float('inf')
    return float(np.concatenate(fits).mean()), residual, (metres, degrees)

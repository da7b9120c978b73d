"""Decide whether the pose of a recording can be trusted: used, doubtful or refused, and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.truth.alignment import PosedImage
from flexx2_sim_ros.truth.joint import Solution
from flexx2_sim_ros.truth.registration import MOST_METRES, Registered, strays, TOLD
import numpy as np

# A pixel fits if its residual is at most this many metres and standard deviations.
_FITS, _FITS_NOISE = 0.05, 3.0
_LEAST__FITTING = 0.6
_FITTING = 0.8
_RIVAL = 1.3  # times the cost of the best pose
_MOST_DEGREES = 0.5  # standard deviation of a pose
# Cost of the best pose in the mirror image of the room, as a fraction of the cost in the room.
_MIRRORED = 0.4
_OUTLYING, _OUTLYING_METRES = 3.0, 0.01  # times the usual median residual; metres

_LOST = 'the camera is lost: none of the frames that were tried fits the room'


@dataclass(frozen=True)
class RoomFit:
    """
    How well a recording fits the room.

    * `state`: ``used``, ``doubtful`` or ``refused``.
    * `reasons`: why it is doubtful or refused.
    * `fitting`: fraction of its pixels that fit the room.
    * `residual`: median of the absolute residual, metres.
    * `deviation`: standard deviation of the pose along and about its least certain axis: metres,
      degrees.
    """

    state: str
    reasons: tuple[str, ...]
    fitting: float
    residual: float
    deviation: tuple[float, float]


def as_given(one: Registered, views: Sequence[PosedImage], off: str) -> RoomFit:
    """Return the verdict of a recording whose poses are used as given; see `common_motion`."""
    assert one.given is not None
    fitting, residual = _misfit(views)
    reasons = tuple(reason for reason in (off, one.why) if reason)
    return RoomFit('doubtful' if off else 'used', reasons, fitting, residual, _worst(one.given))


def judge(registered: Sequence[Registered], solution: Solution) -> list[RoomFit]:
    """Return the verdicts of all recordings, by number; the solution has views of all."""
    numbers = [_numbers(i, solution) for i in range(len(registered))]
    seen = {view.recording for view in solution.views}
    usual = float(np.median([numbers[i][1] for i in sorted(seen)])) if seen else 0.0
    out = []
    for i, (one, (fitting, residual, deviation)) in enumerate(
        zip(registered, numbers, strict=True)
    ):
        refused, doubts = [], []
        if i not in seen:
            out.append(RoomFit('refused', (_LOST,), fitting, residual, deviation))
            continue
        if one.told is not None and strays(one.told):
            refused.append(
                f'its pose is {one.told[0]:.2f} m and {one.told[1]:.0f} degrees from the given '
                f'one, which may be off by {TOLD[0]:g} m and {TOLD[1]:g} degrees; if the given '
                'ones are right, say how accurate they are (--pose-accuracy)'
            )
        if fitting < _LEAST__FITTING:
            refused.append(f'only {fitting:.0%} of its pixels fit the room')
        elif fitting < _FITTING:
            doubts.append(f'only {fitting:.0%} of its pixels fit the room')
        if one.rival < _RIVAL * min(one.costs):
            doubts.append('another pose fits nearly as well')
        if deviation[0] > MOST_METRES or deviation[1] > _MOST_DEGREES:
            doubts.append(
                f'what it sees does not hold its pose: {deviation[0] * 1e3:.0f} mm and '
                f'{deviation[1]:.1f} degrees along the worst axes'
            )
        if len(seen) > 2 and residual > max(_OUTLYING * usual, _OUTLYING_METRES):
            doubts.append(
                f'its residual is {residual * 1e3:.0f} mm, that of most is {usual * 1e3:.0f} mm'
            )
        state = 'refused' if refused else 'doubtful' if doubts else 'used'
        out.append(RoomFit(state, tuple(refused + doubts), fitting, residual, deviation))
    return out


def check_room(
    room: Path, posed: bool, registered: Sequence[Registered], verdicts: Sequence[RoomFit]
) -> None:
    """Refuse a room that is another one, or mirrored, by the verdicts of all recordings."""
    refused = [verdict for verdict in verdicts if verdict.state == 'refused']
    better = [one.mirrored < _MIRRORED * min(one.costs) for one in registered]
    used = sum(
        verdict.state == 'used' and not other
        for verdict, other in zip(verdicts, better, strict=True)
    )
    if sum(better) > used:
        raise InputError(
            f'{room}: must not be mirrored: the recordings fit its mirror image; negate '
            'one coordinate of the mesh'
        )
    # Some recordings may fit a wrong room by chance: rooms are boxes of about the same size.
    pairs = zip(registered, verdicts, strict=True)
    fitting = [verdict.fitting for one, verdict in pairs if one.given is None]
    usual = float(np.median(fitting)) if fitting else 1.0
    if len(refused) > used and usual < _FITTING:
        hint = '' if posed else ', or the wrong --up'
        raise InputError(
            f'{room}: must be the room of the recordings: only {usual:.0%} of the '
            f'pixels of most recordings fit it; it is another room{hint}, or the pose is far off'
        )


def _numbers(recording: int, solution: Solution) -> tuple[float, float, tuple[float, float]]:
    mine = [i for i, view in enumerate(solution.views) if view.recording == recording]
    if not mine:
        return 0.0, float('inf'), (float('inf'), float('inf'))
    fitting, residual = _misfit([solution.views[i] for i in mine])
    spread = sum((solution.covariances[i] for i in mine), np.zeros((6, 6))) / len(mine)
    return fitting, residual, _worst(spread)


def _worst(spread: np.ndarray) -> tuple[float, float]:
    # Standard deviations of a pose along and about its least certain axes, metres and degrees.
    metres, turn = (np.sqrt(np.linalg.eigvalsh(spread[i : i + 3, i : i + 3])[-1]) for i in (0, 3))
    return float(metres), float(np.degrees(turn))


def _misfit(views: Sequence[PosedImage]) -> tuple[float, float]:
    # The fraction of pixels that fit, and the median residual, metres.
    left = np.abs(np.concatenate([view.error for view in views] or [np.zeros(0)]))
    if not len(left):
        return 0.0, float('inf')
    sigma = np.concatenate([view.target.sigma for view in views])
    with np.errstate(invalid='ignore'):
        fits = left < _FITS + _FITS_NOISE * sigma
    every = left[np.isfinite(left)]
    return float(fits.mean()), float(np.median(every)) if len(every) else float('inf')

"""Decide whether the pose of a recording can be trusted: used, doubtful or refused, and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import least_certain
from flexx2_sim_ros.truth.alignment import GRAZING, PosedImage
from flexx2_sim_ros.truth.joint import Solution
from flexx2_sim_ros.truth.registration import MOST_METRES, Registered, strays, TOLD
from flexx2_sim_ros.truth.solver import robust_sigma, tile_sums
import numpy as np

# How accurate a room is, metres: what is assumed where recordings do not show it, and the least
# that they can show: surfaces that are all too near look like an offset of the camera. ASSUMED
_USUAL_ERROR, _LEAST_ERROR = 0.003, 0.001
_LEAST_TILES, _IN_TILE = 30, 4  # beyond those that the fit takes; pixels. ASSUMED
_MEDIAN_SPREAD = 2.3  # relative standard deviation of a robust variance, times the root of tiles
_SURELY = 2.0  # standard deviations
# A pixel fits if its residual is at most this many metres and standard deviations.
_FITS, _FITS_NOISE = 0.05, 3.0
_LEAST_FITTING = 0.6
_FITTING = 0.8
_RIVAL = 1.3  # times the cost of the best pose
_MOST_DEGREES = 0.5  # standard deviation of a pose
# Cost of the best pose in the mirror image of the room, as a fraction of the cost in the room.
_MIRRORED = 0.4

_LOST = 'the camera is lost: none of the frames that were tried fits the room'


@dataclass(frozen=True)
class RoomFit:
    """How well a recording fits the room."""

    state: str  # used, doubtful or refused
    reasons: tuple[str, ...]  # why it is doubtful or refused
    fitting: float = 0.0  # fraction of its pixels that fit the room
    residual: float = math.inf  # median of the absolute residual, metres
    # Standard deviation of the pose along and about its least certain axis: metres, degrees.
    deviation: tuple[float, float] = (math.inf, math.inf)


def room_error(solution: Solution) -> tuple[float, str]:
    """
    Return how accurate a room is, metres, and whether that is estimated, or assumed and why.

    It is how far smooth surfaces of all recordings differ from it along normals, beyond noise and
    the errors that they share.
    """
    tiles = np.vstack([_tiles(view) for view in solution.views] or [np.zeros((0, 3))])
    freedom = len(tiles) - 6 * len(solution.views) - len(solution.values)
    if freedom < _LEAST_TILES:
        return _USUAL_ERROR, 'assumed: few flat patches are seen'
    mean, within, noise = tiles.T
    between = float(robust_sigma(mean)) ** 2
    doubt = _SURELY * _MEDIAN_SPREAD * between / np.sqrt(freedom)
    parts = between - float(np.median(noise)), float(np.median(within))
    error = float(np.sqrt(sum(max(part, 0.0) for part in parts) + doubt))
    if error > _USUAL_ERROR:
        apart = f'recordings and room differ by {error * 1e3:.1f} mm on flat patches'
        return _USUAL_ERROR, f'assumed: {apart}, which may be an error of the camera'
    return float(np.ceil(max(error, _LEAST_ERROR) * 1e4 - 1e-6) / 1e4), (
        'estimated: surfaces that are all too near, or too far, are not seen'
    )


def _tiles(view: PosedImage) -> np.ndarray:
    # (M, 3) of blocks of pixels: the mean error along the normal, the variance within beyond that
    # of noise, and the variance of the mean by noise.
    slant = -view.hits.slant(view.rays)
    error, noise = view.error * slant, (view.target.sigma * slant) ** 2
    good = np.isfinite(error) & (slant > GRAZING * view.target.length)
    values = np.stack([np.ones(len(error)), error, error**2, noise], axis=1)
    sums = tile_sums(view.target.tile[good], values[good])
    count, first, second, noise = sums[sums[:, 0] >= _IN_TILE].T
    within = (second - first**2 / count) / (count - 1) - noise / count
    return np.stack([first / count, within, noise / count**2], axis=1)


def as_given(one: Registered, views: Sequence[PosedImage], off: str) -> RoomFit:
    """Return the verdict of a recording whose poses are used as given; see `common_motion`."""
    assert one.given is not None
    reasons, state = tuple(why for why in (off, one.why) if why), 'doubtful' if off else 'used'
    return RoomFit(state, reasons, *_misfit(views), least_certain(one.given))


def judge(registered: Mapping[int, Registered], solution: Solution) -> dict[int, RoomFit]:
    """Return the verdicts of recordings, by number."""
    out = {}
    for i, one in registered.items():
        mine = [k for k, view in enumerate(solution.views) if view.recording == i]
        if not mine:
            out[i] = RoomFit('refused', (_LOST,))
            continue
        fitting, residual = _misfit([solution.views[k] for k in mine])
        deviation = least_certain(np.mean([solution.covariances[k] for k in mine], axis=0))
        refused, doubts = [], []
        if one.told is not None and strays(one.told):
            refused.append(
                f'its pose is {one.told[0]:.2f} m and {one.told[1]:.0f} degrees from the given '
                f'one, which may be off by {TOLD[0]:g} m and {TOLD[1]:g} degrees; if the given '
                'ones are right, say how accurate they are (--pose-accuracy)'
            )
        if fitting < _LEAST_FITTING:
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
        state = 'refused' if refused else 'doubtful' if doubts else 'used'
        out[i] = RoomFit(state, tuple(refused + doubts), fitting, residual, deviation)
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

"""Whether poses that are used as they were given are all off by one motion of the camera."""

from collections.abc import Sequence
from dataclasses import replace
import math

from flexx2_sim_ros.truth.alignment import clamped, NO_ERRORS, PosedImage
from flexx2_sim_ros.truth.columns import ErrorColumns
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.solver import damped_step, information, tile_sums, TRUNCATION
import numpy as np

_STEPS, _CONVERGED = 15, 1e-5
# Standard deviations of priors: the motion (metres, radians), a latency (seconds). ASSUMED
_PRIOR = 0.3, math.radians(20), 1.0
_CLEAR = 5.0  # standard deviations
_REACH = 0.5  # metres: poses may be far off
# Costs, 0 to 1: the room is what the recordings show, and much better so. ASSUMED
_MOST_COST, _BETTER = 0.2, 0.5


def common_motion(views: Sequence[PosedImage], covariance: np.ndarray, mount: Pose) -> str:
    """
    Return by which motion of the camera in its body given poses are off; nothing if it is unclear.

    The poses have a (6, 6) covariance; `mount` is the pose of the camera in the body as it was
    given.
    """
    if not any(len(view.linear.y) for view in views):
        return ''
    motion, variance, seen = fitted_motion(views)
    clear = (np.abs(motion) > _CLEAR * np.sqrt(variance + np.diag(covariance))).any()
    before, after = (
        float(np.mean([replace(view, reach=TRUNCATION).cost for view in some]))
        for some in (views, seen)
    )
    if not clear or after > min(_MOST_COST, _BETTER * before):
        return ''
    metres, turn = np.linalg.norm(motion[:3]), math.degrees(np.linalg.norm(motion[3:]))
    better = ','.join(f'{number:.4g}' for number in mount.moved(motion).numbers())
    return (
        f'the given poses are all off by {metres * 1e3:.0f} mm and {turn:.1f} degrees: measure '
        f'--camera-in-body again (what the recordings show: {better})'
    )


def fitted_motion(views: Sequence[PosedImage]) -> tuple[np.ndarray, np.ndarray, list[PosedImage]]:
    """
    Return the motion of the camera in its body that fits best, its variances, and the views so.

    Motion and variances are (6,). A latency and a bias of the camera are fitted with it.
    """
    bounce = any(view.bounce.any() for view in views)
    columns = replace(NO_ERRORS, bias=True, bounce=bounce)
    precision = np.concatenate([np.repeat(_PRIOR, [3, 3, 1]) ** -2.0, columns.precision])
    values, eye = np.zeros(len(precision)), np.eye(len(precision))
    for _ in range(_STEPS):
        seen = [_at(view, columns, values) for view in views]
        J, weight, left, tile = _equations(seen)  # noqa: N806
        weights = np.concatenate([weight, precision])
        step = damped_step(np.vstack([J, eye]), weights, np.concatenate([left, -values]), 0.0)
        step[:6] = clamped(step[:6])
        values = values + step
        if np.abs(step).max() < _CONVERGED:
            break
    inverse = np.linalg.inv(information(J, weight) + np.diag(precision))
    score = tile_sums(tile, J * (weight * left)[:, None])  # Errors within one are not independent.
    spread = inverse @ (score.T @ score + np.diag(precision)) @ inverse
    return values[:6], np.diag(spread)[:6], seen


def _at(view: PosedImage, columns: ErrorColumns, values: np.ndarray) -> PosedImage:
    # The view from where the camera is with these values.
    pose = view.pose.moved(values[:6] - values[6] * view.speed)
    return replace(view, pose=pose, columns=columns, values=values[7:], reach=_REACH)


def _equations(views: Sequence[PosedImage]) -> tuple[np.ndarray, ...]:
    # Slopes by all values, weights, what is left, and tiles, of all pixels.
    parts, first = [], 0
    for view in views:
        one = view.linear
        slopes = np.column_stack([one.J, -one.J @ view.speed, one.A])
        parts.append((slopes, one.weight, one.y - one.A @ view.values, one.tile + first))
        first += int(view.target.tile.max(initial=-1)) + 1
    return tuple(map(np.concatenate, zip(*parts, strict=True)))

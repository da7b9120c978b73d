"""Whether poses that are used as they were given are all off by one motion of the camera."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math

from flexx2_sim_ros.truth.alignment import NO_ERRORS, PosedImage
from flexx2_sim_ros.truth.columns import ErrorColumns
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.solver import damped_step, information, minimise, tile_sums
import numpy as np

_STEPS, _CONVERGED = 15, 1e-5
_LATE = 1.0  # seconds, standard deviation of the prior of a latency. ASSUMED
_PRIOR = 0.3, math.radians(20)  # of the motion: metres and radians. ASSUMED
_CLEAR = 5.0  # standard deviations
_REACH = 0.5  # metres: poses may be far off


@dataclass(frozen=True)
class _Together:
    # Views from given poses, which one motion of the camera in its body, a latency (seconds) and
    # the errors of the camera change: the numbers in `values`; a `State`.
    given: tuple[PosedImage, ...]
    columns: ErrorColumns
    values: np.ndarray

    @cached_property
    def views(self) -> list[PosedImage]:
        motion, late, errors = self.values[:6], self.values[6], self.values[7:]
        return [
            replace(
                view,
                pose=view.pose.moved(motion - late * view.speed),
                columns=self.columns,
                values=errors,
                reach=_REACH,
            )
            for view in self.given
        ]

    @cached_property
    def equations(self) -> tuple[np.ndarray, ...]:
        # Slopes, weights, what is left, and tiles, of all pixels; then those of the priors.
        parts, first = [], 0
        for view in self.views:
            one = view.linear
            slopes = np.column_stack([one.J, -one.J @ view.speed, one.A])
            parts.append((slopes, one.weight, one.y - one.A @ view.values, one.tile + first))
            first += int(view.target.tile.max(initial=-1)) + 1
        return tuple(map(np.concatenate, zip(*parts, strict=True)))

    @property
    def precision(self) -> np.ndarray:
        own = np.repeat([*_PRIOR, _LATE], [3, 3, 1])
        return np.concatenate([own**-2.0, self.columns.precision])

    def step(self, damping: float) -> np.ndarray:
        J, weight, left, _ = self.equations
        eye = np.eye(len(self.values))
        return damped_step(
            np.vstack([J, eye]),
            np.concatenate([weight, self.precision]),
            np.concatenate([left, -self.values]),
            damping,
        )

    def moved(self, step: np.ndarray) -> '_Together':
        return replace(self, values=self.values + step)

    def loss(self, other: '_Together') -> float:
        return float(np.mean([view.cost for view in other.views]))

    @property
    def covariance(self) -> np.ndarray:
        # Errors within a tile are not independent.
        J, weight, left, tile = self.equations
        inverse = np.linalg.inv(information(J, weight) + np.diag(self.precision))
        score = tile_sums(tile, J * (weight * left)[:, None])
        return np.asarray(inverse @ (score.T @ score + np.diag(self.precision)) @ inverse)


def common_motion(views: Sequence[PosedImage], accuracy: tuple[float, float], mount: Pose) -> str:
    """
    Return by which motion of the camera in its body given poses are off; nothing if it is unclear.

    The poses are right within `accuracy`, metres and degrees; `mount` is the pose of the camera in
    the body as it was given. A latency and a bias of the camera are fitted with the motion.

    """
    bounce = any(view.bounce.any() for view in views)
    columns = replace(NO_ERRORS, bias=True, bounce=bounce)
    start = _Together(tuple(views), columns, np.zeros(7 + len(columns.names)))
    if not views or not len(start.equations[2]):
        return ''
    found = minimise(start, _STEPS, _CONVERGED)
    motion, spread = found.values[:6], found.covariance[:6, :6]
    sigmas = np.repeat([accuracy[0], math.radians(accuracy[1])], 3)
    off = np.abs(motion) / np.sqrt(np.diag(spread) + sigmas**2)
    if off.max() < _CLEAR:
        return ''
    metres, turn = np.linalg.norm(motion[:3]), math.degrees(np.linalg.norm(motion[3:]))
    better = ','.join(f'{number:.4g}' for number in mount.moved(motion).numbers())
    return (
        f'the given poses are all off by {metres * 1e3:.0f} mm and {turn:.1f} degrees: measure '
        f'--camera-in-body again (what the recordings show: {better})'
    )

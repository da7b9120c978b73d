"""
Errors of each recording's own: its pose, brightness, edges, and planes known within bounds only.

They are nuisances of the fit. Each has a prior: a pose or plane whose covariance the recording
gives is held by that, the poses of the other recordings by the spread that they turn out to have.
"""

from collections.abc import Sequence
from copy import copy

from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.calibration.inference import Loss, THRESHOLDS
from flexx2_sim_ros.gap.data.pose import STEPS
from flexx2_sim_ros.gap.data.prior import free_planes, POSE
from flexx2_sim_ros.gap.data.unknown import PLANE_STEPS
from flexx2_sim_ros.gap.features.evidence import Evidence
import numpy as np
from scipy import stats

COMMON = 11  # of every recording: pose (6), brightness, edges (4); planes come after them


class OwnErrors:
    """
    The recordings' own errors, and what is known of them beforehand.

    `covariances` are as from `prior.covariance_of`. `registered`: registration has taken something
    off.

    * `count`: N, of each recording; those with fewer planes have some that change nothing.
    * `pose`: (R, 6) what registration has taken off, in steps.
    * `planes`: (R, N - 11) likewise.
    * `posed`: (R,) bool, whether a recording's pose may be wrong.
    * `centre`: (6,) about which those poses lie that may be wrong, in steps, if that is known.
    """

    def __init__(
        self,
        evidence: Sequence[Evidence],
        covariances: Sequence[np.ndarray | None],
        constants: Loss,
        registered: bool = True,
    ) -> None:
        """Invert the covariances."""
        self._about, self._floor = constants, np.array(constants.pose_floor)
        number = max(len(e.planes) for e in evidence)
        self.count = COMMON + number
        self.centre: np.ndarray | None = None
        self.pose = np.array([e.pose for e in evidence]) / STEPS
        self.planes = np.zeros((len(evidence), number))
        for row, e in zip(self.planes, evidence, strict=True):
            row[: len(e.planes)] = e.planes / np.resize(PLANE_STEPS, len(e.planes))
        if not registered:
            self.pose, self.planes = 0 * self.pose, 0 * self.planes
        self._precision = [None if c is None else self._inverse(c) for c in covariances]
        self._free = [free_planes(c) for c in covariances]
        self._usual = np.array([c is None for c in covariances])
        # Not where it is given as exact, as with planes, which are measured from the camera.
        self.posed = np.array([c is None or bool(c[:POSE, :POSE].any()) for c in covariances])

    def found(self, amounts: np.ndarray) -> list[np.ndarray]:
        """
        Return each recording's pose and planes in all, as `registration.place` takes them.

        `amounts` is (R, N) beyond registration, in steps.
        """
        pose = (self.pose + amounts[:, :POSE]) * STEPS
        steps = np.resize(PLANE_STEPS, self.planes.shape[1])
        planes = (self.planes + amounts[:, COMMON:]) * steps
        return [
            np.concatenate([one, other[: 0 if p is None else len(p) - POSE]])
            for one, other, p in zip(pose, planes, self._precision, strict=True)
        ]

    def free_planes_at(self, amounts: np.ndarray) -> list[np.ndarray | None]:
        """Return `found` of the recordings whose planes are free, None for the others."""
        found = self.found(amounts)
        return [one if free else None for one, free in zip(found, self._free, strict=True)]

    def elsewhere(self, motions: Sequence[np.ndarray], posed: bool) -> list[np.ndarray]:
        """
        Return the poses at which it shows what effects do in other scenes.

        `motions` are (6 + 3 P,) where each recording's camera and planes are, as for
        `registration.place`.

        The pose of each recording is fitted. Poses can take over a part of what the recordings
        have in common, such as a bias; then effects that only imitate the cause seem to fit. In
        other scenes, poses do not err in the same direction. So what the fitted poses have in
        common is taken off, as far as it is more than their scatter explains: their mean m with
        the standard error e times 1 - (t e / m)^2 if that is positive, for each of the six motions
        (the garrote of Breiman, 1995). t is the quantile of Student's t that scatter alone exceeds
        in one of the six motions of one set of poses in 20 (Bonferroni).

        If a pose error is among the effects (`posed`), other poses are as wrong, and nothing
        simulates it: the given ones are returned. A recording that says how exact its pose is
        keeps its own.
        """
        out = [np.array(one) for one in motions]
        free = [one for one, usual in zip(out, self._usual, strict=True) if usual]
        common = np.zeros(POSE)
        if len(free) > 1 and not posed:
            common = common_motion(np.array([one[:POSE] for one in free]))
        for one in free:
            one[:POSE] -= one[:POSE] if posed else common
        return out

    def at(self, motions: Sequence[np.ndarray]) -> 'OwnErrors':
        """
        Return the same errors of recordings that were moved there; the inverse of `found`.

        `motions` are (6 + 3 P,), each recording's pose and planes in all.
        """
        other = copy(self)
        other.pose = np.array([one[:POSE] for one in motions]) / STEPS
        other.planes = np.zeros_like(self.planes)
        for row, one in zip(other.planes, motions, strict=True):
            planes = one[POSE:]
            row[: len(planes)] = planes / np.resize(PLANE_STEPS, len(planes))
        return other

    def loss(self, amounts: np.ndarray, common_pose: bool, held_out: bool = False) -> float:
        """
        Return the penalty for the errors, (R, N) `amounts`.

        Poses without a covariance are penalised by the logarithm of their spread. With
        `common_pose` the recordings may share a pose error, which is not penalised; with
        `held_out` that of each recording is estimated from the others.
        """
        q, about = self._off(amounts, common_pose), self._about
        if common_pose and held_out and self.centre is None:
            number = self.posed.sum()
            q[self.posed] *= number / max(number - 1, 1)
        poses = self._cost(q, self.planes + amounts[:, COMMON:])
        return float(
            poses.sum()
            + about.brightness_weight * np.square(amounts[:, POSE]).sum()
            + about.edge_weight * np.square(amounts[:, POSE + 1 : COMMON]).sum()
        )

    def cost(self, motions: Sequence[np.ndarray]) -> np.ndarray:
        """
        Return what it costs, (R,), that each recording's camera and planes are there.

        `motions` are (6 + 3 P,), pose and planes in all. It is their part of `loss`.
        """
        there = self.at(motions)
        return there._cost(there._off(np.zeros((len(motions), POSE)), False), there.planes)

    def _cost(self, q: np.ndarray, planes: np.ndarray) -> np.ndarray:
        # (R,) of poses (R, 6) and planes that are so far off, in steps.
        usual, weight = q[self._usual], self._about.pose_weight
        spread = (usual**2).mean(axis=0) if len(usual) else np.zeros(POSE)
        out = np.full(len(q), weight * np.log1p(spread / self._floor**2).sum())
        for r, precision in enumerate(self._precision):
            if precision is not None:
                both = np.concatenate([q[r], planes[r]])[: len(precision)]
                out[r] = weight * both @ precision @ both
        return out

    def prior(self, amounts: np.ndarray, common_pose: bool) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the prior, linearised at (R, N) `amounts` for one step of least squares.

        It is a stiffness, (R, N, N), and by how much it pulls back, (R, N), for the right side.
        With `common_pose` all recordings may have a pose error in common.
        """
        q = self._off(amounts, common_pose)
        usual = q[self._usual]
        spread = (usual**2).mean(axis=0) if len(usual) else np.zeros(POSE)
        stiff, about = np.ones(self.count), self._about
        stiff[:POSE] = about.pose_weight / (self._floor**2 + spread)
        stiff[POSE:COMMON] = [about.brightness_weight] + [about.edge_weight] * 4
        off = np.concatenate([q, amounts[:, POSE:COMMON], self.planes + amounts[:, COMMON:]], 1)
        matrices = np.tile(np.diag(stiff), (len(amounts), 1, 1))
        for matrix, precision in zip(matrices, self._precision, strict=True):
            if precision is not None:
                planes = COMMON + np.arange(len(precision) - POSE)
                index = np.concatenate([np.arange(POSE), planes])
                matrix[np.ix_(index, index)] = about.pose_weight * precision
        return matrices, (matrices @ off[..., None])[..., 0]

    def _off(self, amounts: np.ndarray, common_pose: bool) -> np.ndarray:
        # (R, 6) how far the poses are from where they are believed to lie.
        q = self.pose + amounts[:, :POSE]
        if self.centre is not None:
            q[self.posed] -= self.centre
        elif common_pose and self.posed.any():
            q[self.posed] -= q[self.posed].mean(axis=0)
        return np.asarray(q)

    def _inverse(self, covariance: np.ndarray) -> np.ndarray:
        # In steps, of a covariance that is never less than what features can tell.
        planes = len(covariance) - POSE
        steps = np.concatenate([STEPS, np.resize(PLANE_STEPS, planes)])
        floor = np.concatenate([self._floor, np.full(planes, GROUND_TRUTH.plane_floor)])
        return np.linalg.inv(covariance / np.outer(steps, steps) + np.diag(floor**2))


def common_motion(poses: np.ndarray) -> np.ndarray:
    """
    Return the mean of motions, (6,), as far as it is more than their scatter explains.

    `poses` is (R, 6) of at least two recordings. The result is between 0 and the mean; see
    `OwnErrors.elsewhere`.
    """
    count = len(poses)
    mean, error = poses.mean(axis=0), poses.std(axis=0, ddof=1) / np.sqrt(count)
    least = stats.t.ppf(1 - THRESHOLDS.common_pose / (2 * POSE), count - 1) * error
    away = np.abs(mean) > least
    return np.where(away, mean * (1 - np.square(least / np.where(away, mean, 1.0))), 0.0)

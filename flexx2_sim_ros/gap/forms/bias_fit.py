"""Fit forms of a bias to all recordings together with the pose of each, and leave one out."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms.bias import Form, hats
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.physics.poses import weighted_equations
import numpy as np
from scipy.linalg import block_diag


@dataclass(frozen=True)
class FittedForms:
    """
    Coefficients of some forms.

    (K,) `together` are fitted to all recordings, (R, K) `without` to all but one. (R,) `losses`
    are of each recording with the coefficients that it had no part in; chi squared a sample.
    """

    forms: tuple[Form, ...]
    together: np.ndarray
    without: np.ndarray
    losses: np.ndarray

    def part(self, form: Form) -> slice:
        """Return which coefficients are a form's."""
        place = self.forms.index(form)
        start = sum(one.size for one in self.forms[:place])
        return slice(start, start + form.size)


class BiasFit:
    """
    Recordings to fit forms of a bias to; `samples` has one for each.

    Each recording's own pose and planes are fitted at the same time, held by their prior, and
    eliminated from the normal equations: fitted first, they would take up most of the bias.
    """

    def __init__(self, samples: Sequence[Samples]) -> None:
        """Find weights of the samples with the most flexible form."""
        self.samples = list(samples)
        self._weights = [_robust_weights(one) for one in self.samples]
        self._eliminate_motions()

    def _eliminate_motions(self) -> None:
        both = zip(self.samples, self._weights, strict=True)
        self._parts = [_WithoutOwn(one, weight) for one, weight in both]

    def fit(self, forms: Sequence[Form]) -> FittedForms:
        """Fit forms to all recordings, and to all but one."""
        columns = [np.concatenate([form.columns(one) for form in forms]) for one in self.samples]
        return FittedForms(
            tuple(forms), *self.solve(columns, block_diag(*(form.penalty() for form in forms)))
        )

    def solve(
        self, columns: Sequence[np.ndarray], penalty: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Fit shared coefficients to all recordings, and to all but one.

        `columns` are (K, N) metres of depth for a coefficient of 1 each, for each recording;
        `penalty` is (K, K) on the coefficients. Return `together`, `without` and `losses` of
        `FittedForms`.
        """
        parts = [part.equations(own) for own, part in zip(columns, self._parts, strict=True)]
        S, s = (sum(part[i] for part in parts) for i in (0, 1))
        without = np.array([np.linalg.solve(S - a + penalty, s - b) for a, b, *_ in parts])
        losses = [
            (c - 2 * theta @ b + theta @ a @ theta) / n
            for (a, b, c, n), theta in zip(parts, without, strict=True)
        ]
        return np.linalg.solve(S + penalty, s), without, np.array(losses)

    def with_usual_poses(self, columns: Sequence[np.ndarray], penalty: np.ndarray) -> 'BiasFit':
        """
        Return the same with priors of the poses as wide as the fitted poses are; never wider.

        A wider prior lets the poses take up what a wrong lens does. Parameters are those of
        `solve`, of what is fitted at the same time.
        """
        out = copy(self)
        for _ in range(FORMS.iterations):  # Expectation and maximisation.
            shared = out.solve(columns, penalty)[0]
            squares = np.concatenate(
                [
                    _own_squares(one, weight, shared @ own)
                    for one, weight, own in zip(out.samples, self._weights, columns, strict=True)
                ]
            )
            factor = min(float(np.sqrt(squares.mean())), 1.0) if len(squares) else 1.0
            out.samples = [replace(one, spread=factor * one.spread) for one in out.samples]
            out._eliminate_motions()
        return out

    def best(self, groups: Sequence[Sequence[Form]], others: Sequence[Form] = ()) -> FittedForms:
        """
        Return the form that left-out recordings pay for, fitted together with `others`.

        `groups` go from simple to flexible, see `bias.forms_of`; `others` are forms of other
        effects.
        """
        chosen: FittedForms | None = None
        for group in groups:
            fits = [self.fit([form, *others]) for form in group]
            one = min(fits, key=lambda fit: float(fit.losses.sum()))
            if chosen is None or is_surely_less(one.losses, chosen.losses):
                chosen = one
        assert chosen is not None
        return chosen


def is_surely_less(one: np.ndarray, other: np.ndarray) -> bool:
    """Say whether (R,) values are less than others, by more than a standard error of the mean."""
    gain = other - one
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    return bool(gain.mean() > FORMS.surer * error and gain.mean() > 0)


def own_motion(samples: Samples, error: np.ndarray, registered: np.ndarray) -> np.ndarray:
    """
    Return where a recording's camera and planes were if so much is left of the errors.

    (N,) `error`, metres, is what no effect explains. What surfaces leave open stays as it is in
    `registered`, the (6 + 3 P,) motion as from `register`: it comes from outlines.
    """
    own, target, _, ridge = _whitened(samples, error)
    start = np.linalg.pinv(samples.spread) @ (samples.motion - registered)
    step, _ = _robust_step(own, target, start, ridge)
    return samples.motion + samples.spread @ step


def usual_factor(samples: Sequence[Samples]) -> float:
    """
    Return how wide the poses of recordings are, as a fraction of their prior; at most 1.

    Each part of a motion counts as far as the recording tells it (MacKay 1992, Bayesian
    interpolation): walls leave some open.
    """
    factor = 1.0
    for _ in range(FORMS.iterations):
        squares = told = 0.0
        for one in samples:
            narrow = replace(one, spread=factor * one.spread)
            own, target, start, ridge = _whitened(narrow, one.error)
            step, weight = _robust_step(own, target, start, ridge)
            squares += float(((start + step) ** 2).sum())
            told += float((1 - _variances(own, weight, ridge)).sum())
        if told > 0:
            factor = min(factor * float(np.sqrt(squares / told)), 1.0)
    return factor


def misfit(samples: Samples, error: np.ndarray) -> float:
    """
    Return how badly a recording's motion explains errors, (N,) metres, at the best motion.

    That is squares of the motion in standard deviations, and as many as the errors are worth.
    """
    own, target, start, ridge = _whitened(samples, error)
    step, _ = _robust_step(own, target, start, ridge)
    rest = (target - step @ own) / FORMS.robust
    errors = FORMS.robust**2 * np.log1p(rest**2).sum() / ridge
    return float(errors + ((start + step) ** 2).sum())


def _robust_step(
    own: np.ndarray, target: np.ndarray, start: np.ndarray, ridge: float
) -> tuple[np.ndarray, np.ndarray]:
    # What is to be added to a motion, in standard deviations, and the weights of the errors.
    weight = np.ones(len(target))
    for _ in range(FORMS.iterations):
        step = _solve_own(own, target, weight, start, ridge)
        weight = _cauchy(target - step @ own)
    return step, weight


def _whitened(
    samples: Samples, error: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    # Own columns in standard deviations of their prior, errors, where the motion is already, and
    # the prior's weight.
    own = samples.spread.T @ samples.own / samples.sigma
    start = np.linalg.pinv(samples.spread) @ samples.motion
    return own, error / samples.sigma, start, REGISTRATION.ridge * max(len(error), 1)


def _solve_own(
    own: np.ndarray, target: np.ndarray, weight: np.ndarray, start: np.ndarray, ridge: float
) -> np.ndarray:
    normal = (own * weight) @ own.T + ridge * np.eye(len(own))
    return np.linalg.solve(normal, (own * weight) @ target - ridge * start)


def _variances(own: np.ndarray, weight: np.ndarray, ridge: float) -> np.ndarray:
    # Of what is fitted. The ridge weighs the prior against errors that are alike in neighbouring
    # pixels, so it also scales these.
    normal = (own * weight) @ own.T + ridge * np.eye(len(own))
    return np.asarray(ridge * np.diag(np.linalg.inv(normal)))


def _own_squares(samples: Samples, weight: np.ndarray, shared: np.ndarray) -> np.ndarray:
    # Expected squares of a recording's motion, in variances of its prior, where that has any.
    own, target, start, ridge = _whitened(samples, samples.error - shared)
    step = _solve_own(own, target, weight, start, ridge)
    squares = (start + step) ** 2 + _variances(own, weight, ridge)
    return np.asarray(squares[samples.spread.any(axis=0)])


def _cauchy(residual: np.ndarray) -> np.ndarray:
    return 1 / (1 + (residual / FORMS.robust) ** 2)


def _robust_weights(samples: Samples) -> np.ndarray:
    # With all that any form could explain taken off, so that no form sets the weights for others.
    flexible = [
        hats(np.linspace(values.min(), values.max(), FORMS.free_knots))(values) / samples.length
        for values in (samples.distance, samples.light)
        if len(values)
    ]
    own, target, start, ridge = _whitened(samples, samples.error)
    if not flexible:
        return np.ones(0)
    free = np.concatenate(flexible) / samples.sigma
    lens = [slopes / samples.sigma for slopes in samples.slopes.values()]
    A = np.concatenate([own, free, *lens])
    prior = np.full(len(A), 1.0)
    prior[: len(own)], prior[len(own) : len(own) + len(free)] = ridge, FORMS.ridge
    centre = np.zeros(len(A))
    centre[: len(own)] = ridge * start
    weight = np.ones(len(target))
    for _ in range(FORMS.iterations):
        normal, right = weighted_equations(A, weight, target)
        weight = _cauchy(target - np.linalg.solve(normal + np.diag(prior), right - centre) @ A)
    return weight


class _WithoutOwn:
    # A recording's part of normal equations, with its own motion eliminated.

    def __init__(self, samples: Samples, weight: np.ndarray) -> None:
        self._own, target, start, ridge = _whitened(samples, samples.error)
        self._sigma, self._weight, self._target = samples.sigma, weight, target
        own = self._own * weight
        self._normal = own @ self._own.T + ridge * np.eye(len(own))
        self._right = own @ target - ridge * start
        self._constant = float((weight * target) @ target + ridge * start @ start)

    def equations(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, int]:
        # Of the coefficients of columns: matrix, right side, constant of the loss, and samples.
        shared = columns / self._sigma
        weighted = shared * self._weight
        mixed = weighted @ self._own.T
        solved = np.linalg.solve(self._normal, np.column_stack([mixed.T, self._right]))
        return (
            weighted @ shared.T - mixed @ solved[:, :-1],
            weighted @ self._target - mixed @ solved[:, -1],
            self._constant - float(self._right @ solved[:, -1]),
            max(len(self._target), 1),
        )

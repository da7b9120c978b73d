"""Fit forms of a bias to all recordings together with the pose of each, and leave one out."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.data import REGISTRATION
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms.bias import Form, hats
from flexx2_sim_ros.gap.forms.samples import Samples
import numpy as np


@dataclass(frozen=True)
class Fitted:
    """
    Coefficients of some forms.

    Attributes
    ----------
    forms : tuple of Form
    together : numpy.ndarray
        (K,) fitted to all recordings.
    without : numpy.ndarray
        (R, K) fitted to all but one.
    losses : numpy.ndarray
        (R,) of each recording with the coefficients that it had no part in; chi squared a sample.

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
    Recordings to fit forms of a bias to.

    Each recording's own pose and planes are fitted at the same time, held by their prior, and
    eliminated from the normal equations: fitted first, they would take up most of the bias.

    Parameters
    ----------
    samples : sequence of Samples
        One for each recording.

    """

    def __init__(self, samples: Sequence[Samples]) -> None:
        """Find weights of the samples with the most flexible form."""
        self.samples = list(samples)
        self._parts = [_WithoutOwn(one, _robust_weights(one)) for one in self.samples]

    def fit(self, forms: Sequence[Form]) -> Fitted:
        """Fit forms to all recordings, and to all but one."""
        penalty = _blocks([form.penalty() for form in forms])
        parts = [
            part.equations([form.columns(one) for form in forms])
            for one, part in zip(self.samples, self._parts, strict=True)
        ]
        S, s = (sum(part[i] for part in parts) for i in (0, 1))  # noqa: N806
        without = np.array([np.linalg.solve(S - a + penalty, s - b) for a, b, *_ in parts])
        losses = [
            (c - 2 * theta @ b + theta @ a @ theta) / n
            for (a, b, c, n), theta in zip(parts, without, strict=True)
        ]
        return Fitted(tuple(forms), np.linalg.solve(S + penalty, s), without, np.array(losses))

    def best(self, groups: Sequence[Sequence[Form]], others: Sequence[Form] = ()) -> Fitted:
        """
        Return the form that left-out recordings pay for, fitted.

        Parameters
        ----------
        groups : sequence of sequence of Form
            From simple to flexible; see `bias.forms_of`.
        others : sequence of Form
            Forms of other effects that are fitted at the same time.

        """
        chosen: Fitted | None = None
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


def own_motion(samples: Samples, error: np.ndarray) -> np.ndarray:
    """
    Return where a recording's camera and planes were if so much is left of the errors.

    Parameters
    ----------
    samples : Samples
        The recording's.
    error : numpy.ndarray
        (N,) metres that no effect explains.

    """
    own, target, start, ridge = _whitened(samples, error)
    weight = np.ones(len(error))
    for _ in range(FORMS.iterations):
        step = _solve_own(own, target, weight, start, ridge)
        weight = _cauchy(target - step @ own)
    return samples.motion + samples.spread @ step


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
    A = np.concatenate([own, free])  # noqa: N806
    prior = np.concatenate([np.full(len(own), ridge), np.full(len(free), FORMS.ridge)])
    centre = np.concatenate([ridge * start, np.zeros(len(free))])
    weight = np.ones(len(target))
    for _ in range(FORMS.iterations):
        normal = (A * weight) @ A.T + np.diag(prior)
        weight = _cauchy(target - np.linalg.solve(normal, (A * weight) @ target - centre) @ A)
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

    def equations(
        self, columns: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, float, int]:
        # Of the coefficients of columns: matrix, right side, constant of the loss, and samples.
        shared = np.concatenate(columns) / self._sigma
        weighted = shared * self._weight
        mixed = weighted @ self._own.T
        solved = np.linalg.solve(self._normal, np.column_stack([mixed.T, self._right]))
        return (
            weighted @ shared.T - mixed @ solved[:, :-1],
            weighted @ self._target - mixed @ solved[:, -1],
            self._constant - float(self._right @ solved[:, -1]),
            max(len(self._target), 1),
        )


def _blocks(parts: Sequence[np.ndarray]) -> np.ndarray:
    size = sum(map(len, parts))
    out, start = np.zeros((size, size)), 0
    for part in parts:
        out[start : start + len(part), start : start + len(part)] = part
        start += len(part)
    return out

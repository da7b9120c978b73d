"""Least squares of the few forms of noise that mappers and simulators have."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import least_squares

_FLOOR = 1e-6  # metres; a sigma of 0 has no logarithm


@dataclass(frozen=True)
class NoiseFit:
    """
    A form of noise, fitted to a camera.

    Attributes
    ----------
    form : str
        For people, e.g. ``a z^2``.
    values : tuple of float
        Its coefficients.
    worst, at : float
        The worst ratio of what is written to the camera's own value, 1 where they agree, and its
        distance, metres.

    """

    form: str
    values: tuple[float, ...]
    worst: float
    at: float


def fit_constant(
    distance: np.ndarray, sigma: np.ndarray, low: float = 0.0, high: float = math.inf
) -> NoiseFit:
    """Fit one value from low to high; see `fit_power`."""
    return fit_power(distance, sigma, 0, 'constant', low, high)


def fit_power(
    distance: np.ndarray,
    sigma: np.ndarray,
    power: int,
    form: str,
    low: float = 0.0,
    high: float = math.inf,
) -> NoiseFit:
    """
    Fit ``a z^power`` by least squares of the logarithm: a factor of 2 weighs the same everywhere.

    Distance and sigma are (N,) metres; NaN in sigma is left out. The power is 0 for a constant,
    ``form`` what to call it; a is from ``low`` to ``high``.
    """
    distance, sigma = _seen(distance, sigma)
    value = float(np.clip(np.exp(np.mean(np.log(sigma / distance**power))), low, high))
    return _rated(form, (value,), distance, sigma, value * distance**power)


def fit_structured_light(distance: np.ndarray, sigma: np.ndarray) -> NoiseFit:
    """
    Fit ``a + b (z - c)^2 + d z^e`` by least squares of the logarithm.

    The last term is left out where it does not bring the worst ratio nearer to 1 by half. Distance
    and sigma are (N,) metres; NaN in sigma is left out.
    """
    distance, sigma = _seen(distance, sigma)
    far = float(distance.max())
    three = _least(
        lambda p: p[0] + p[1] * (distance - p[2]) ** 2,
        [(float(sigma.min()), 0.0, far), (1e-4, 0.0, 1.0), (0.0, 0.0, far)],
        distance,
        sigma,
    )
    five = _least(
        lambda p: p[0] + p[1] * (distance - p[2]) ** 2 + p[3] * distance ** p[4],
        [*((v, 0.0, h) for v, h in zip(three[:3], (far, 1.0, far), strict=True)),
         (1e-4, 0.0, 1.0), (2.0, 0.0, 6.0)],
        distance,
        sigma,
    )  # fmt: skip
    fits = [
        _rated('a + b (z - c)^2', (*three, 0.0, 1.0), distance, sigma, _normal(three, distance)),
        _rated('a + b (z - c)^2 + d z^e', tuple(five), distance, sigma, _normal(five, distance)),
    ]
    three_off, five_off = (abs(math.log(fit.worst)) for fit in fits)
    return fits[1] if 2 * five_off < three_off else fits[0]


def _normal(p: Sequence[float], z: np.ndarray) -> np.ndarray:
    last = p[3] * z ** p[4] if len(p) > 3 else 0.0
    return np.asarray(p[0] + p[1] * (z - p[2]) ** 2 + last)


def _least(
    form: Callable[[np.ndarray], np.ndarray],
    bounds: Sequence[tuple[float, float, float]],
    distance: np.ndarray,
    sigma: np.ndarray,
) -> list[float]:
    start, low, high = (np.array(column) for column in zip(*bounds, strict=True))
    start = np.clip(start, low + 1e-9, high - 1e-9)
    found = least_squares(
        lambda p: np.log(np.maximum(form(p), _FLOOR) / sigma),
        start,
        bounds=(low, high),
        x_scale=np.maximum(start, 1e-3),
    )
    return [float(value) for value in found.x]


def _rated(
    form: str,
    values: tuple[float, ...],
    distance: np.ndarray,
    sigma: np.ndarray,
    fitted: np.ndarray,
) -> NoiseFit:
    ratio = np.maximum(fitted, _FLOOR) / sigma
    worst = int(np.argmax(np.abs(np.log(ratio))))
    return NoiseFit(form, values, float(ratio[worst]), float(distance[worst]))


def _seen(distance: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = np.isfinite(sigma)
    return distance[seen], np.maximum(sigma[seen], _FLOOR)


def within(sigma: np.ndarray, half: float) -> np.ndarray:
    """Return the probability that a normal error of spread sigma stays within +-half."""
    scaled = half / (math.sqrt(2.0) * np.maximum(sigma, 1e-12))
    return np.array([math.erf(value) for value in scaled])

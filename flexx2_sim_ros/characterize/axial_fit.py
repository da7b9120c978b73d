"""Fit the axial noise model: least squares for a, b, c, d with n swept, errors and bands."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.tiles import Tiles
from flexx2_sim_ros.profiles.modes import NoiseModel
import numpy as np
from scipy import stats

EXPONENTS = np.round(np.arange(-1.0, 3.05, 0.1), 1)  # as the paper swept n
PAPER_EXPONENT = 2.7
CONFIDENCE = 0.95
NAMES = ('a', 'b', 'c', 'd', 'n')
_REWEIGHTINGS = 4
_SMALLEST = 1e-9  # metres: what never changed has no relative error
# To tell the terms apart, distances must differ by this share and slants by this much (design).
_DISTINCT_SHARE = 0.15
_SLANT_SPAN = math.radians(15)


@dataclass(frozen=True)
class AxialFit:
    """
    A fitted axial model.

    Attributes
    ----------
    coefficients : dict of str to float
        a, b, c, d, n.
    errors : dict of str to float or None
        Standard errors; None for a coefficient that was held because the recordings do not
        determine it, or that too few recordings say how sure it is.
    covariance : numpy.ndarray
        (5, 5), zero for what was held.
    freedom : int
        Recordings less fitted coefficients.
    interval_n : tuple of float or None
        Confidence interval of n.
    sweep : numpy.ndarray
        (len(EXPONENTS),) root mean square relative residual for each n; empty when n was held.
    scatter : float
        Root mean square relative deviation of a recording's noise from the model.
    distances, angles_deg : tuple of float
        Range of what was measured, metres and degrees; the angles NaN when unknown.
    recordings : int
        How many.
    notes : tuple of str
        What was held, and why.

    """

    coefficients: dict[str, float]
    errors: dict[str, float | None]
    covariance: np.ndarray
    freedom: int
    interval_n: tuple[float, float] | None
    sweep: np.ndarray
    scatter: float
    distances: tuple[float, float]
    angles_deg: tuple[float, float]
    recordings: int
    notes: tuple[str, ...]

    def model(self, sigma_x: float = 0.0) -> NoiseModel:
        """Return it as a camera's noise model."""
        return NoiseModel(**self.coefficients, sigma_x=sigma_x, surfaces=None)

    def band(self, z: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """
        Return the half-width of the curve's confidence band, metres, at (N,) metres and radians.

        NaN when too few recordings say how sure the fit is.
        """
        if self.freedom < 1:
            return np.full(len(z), np.nan)
        gradient = _gradient(self.coefficients, z, _slant(theta))
        variance = np.einsum('ni,ij,nj->n', gradient, self.covariance, gradient)
        return _quantile(self.freedom) * np.sqrt(np.maximum(variance, 0.0))


def fit_axial(recordings: list[Tiles]) -> AxialFit:
    """
    Fit the model to the tiles of several recordings, one or more.

    Residuals are relative, since a standard deviation is known to a share of itself; every
    recording weighs the same, however much of the image its board fills. Standard errors come
    from leaving out one recording after another (a jackknife), so that they hold as well where
    recordings differ by more than their pixels' noise.
    """
    z, theta, sigma, weight, group = _join(recordings)
    known = np.isfinite(theta)
    slant = _slant(np.where(known, theta, 0.0))
    centres = np.array([np.average(t.z, weights=t.pixels) for t in recordings])
    free, notes = _determined(centres, z, theta)
    fits = {}
    for n in EXPONENTS if 'n' in free else (PAPER_EXPONENT,):
        fits[n] = _solve(z, slant, sigma, weight, n, free)
    best = min(fits, key=lambda n: fits[n][1])
    values, _ = fits[best]
    if values['d'] < 0:
        # Noise that falls with the angle is not this model's.
        notes.append('d: the best value is negative; it is held at 0')
        free = [name for name in free if name not in ('d', 'n')]
        best, fits = PAPER_EXPONENT, {}
        values, _ = _solve(z, slant, sigma, weight, best, free)
    sweep = np.array([math.sqrt(fits[n][1]) for n in EXPONENTS]) if 'n' in free else np.empty(0)
    covariance, freedom = _jackknife(values, free, z, slant, sigma, weight, group)
    errors = {
        name: math.sqrt(covariance[i, i]) if name in free and freedom > 0 else None
        for i, name in enumerate(NAMES)
    }
    model = _evaluate(values, z, slant)
    ratios = np.array(
        [
            np.sqrt(
                np.sum((weight * sigma**2)[group == g]) / np.sum((weight * model**2)[group == g])
            )
            for g in range(len(recordings))
        ]
    )
    interval = None
    if errors['n'] is not None:
        half = _quantile(freedom) * errors['n']
        interval = values['n'] - half, values['n'] + half
        if 2 * half > np.ptp(EXPONENTS):
            notes.append('n: not determined: its interval is wider than the sweep')
        if best in (EXPONENTS[0], EXPONENTS[-1]):
            notes.append(f'n: the best value is at the end of the sweep, {best:g}')
    angles = np.degrees(theta[known])
    return AxialFit(
        values,
        errors,
        covariance,
        freedom,
        interval,
        sweep,
        float(np.sqrt(np.mean((ratios - 1) ** 2))),
        (float(z.min()), float(z.max())),
        (float(angles.min()), float(angles.max())) if known.any() else (math.nan, math.nan),
        len(recordings),
        tuple(notes),
    )


def _join(recordings: list[Tiles]) -> tuple[np.ndarray, ...]:
    weights = [t.pixels / t.pixels.sum() for t in recordings]
    sigma = np.sqrt(np.concatenate([t.variance for t in recordings]))
    # A sample's standard deviation is too small by a share of 1 / (4 freedom) on average.
    freedom = np.concatenate([t.freedom for t in recordings])
    return (
        np.concatenate([t.z for t in recordings]),
        np.concatenate([t.theta for t in recordings]),
        sigma * (1 + 1 / (4 * freedom)),
        np.concatenate(weights),
        np.repeat(np.arange(len(recordings)), [len(t) for t in recordings]),
    )


def _slant(theta: np.ndarray) -> np.ndarray:
    return (theta / (math.pi / 2 - theta)) ** 2


def _determined(
    centres: np.ndarray, z: np.ndarray, theta: np.ndarray
) -> tuple[list[str], list[str]]:
    """Say which coefficients the recordings determine, and why the others are held."""
    free, notes = ['a'], []
    steps = np.diff(np.log(np.unique(centres)))
    distinct, travelled = 1, 0.0
    for step in steps:
        travelled += step
        if travelled > _DISTINCT_SHARE:
            distinct, travelled = distinct + 1, 0.0
    free += ['b', 'c'][: min(distinct, 3) - 1]
    if distinct < 3:
        notes.append(
            f'{"b and c" if distinct == 1 else "c"}: held at 0: needs boards at 3 distinct '
            f'distances, got {distinct}'
        )
    known = theta[np.isfinite(theta)]
    if not known.size or np.ptp(known) < _SLANT_SPAN:
        notes.append(
            "d: held at 0, n at the paper's 2.7: the incidence angles "
            + (
                f'span {math.degrees(np.ptp(known)):.0f} degrees, must be 15'
                if known.size
                else 'are not known'
            )
        )
        return free, notes
    free.append('d')
    if distinct > 1:
        return [*free, 'n'], notes
    notes.append("n: held at the paper's 2.7: all boards stood at one distance")
    return free, notes


def _solve(
    z: np.ndarray,
    slant: np.ndarray,
    sigma: np.ndarray,
    weight: np.ndarray,
    n: float,
    free: list[str],
) -> tuple[dict[str, float], float]:
    """Return coefficients and the mean square relative residual for one n."""
    terms = {'a': np.ones_like(z), 'b': z, 'c': z**2, 'd': z**n * slant}
    names = [name for name in terms if name in free]
    design = np.stack([terms[name] for name in names], axis=1)
    expected = np.full(len(z), np.average(sigma, weights=weight))
    scale = np.average(sigma / z, weights=weight) * z
    expected = np.maximum(0.5 * (expected + scale), _SMALLEST)
    for _ in range(_REWEIGHTINGS):
        # Relative to the model, not to the measured value, whose errors would pull it down.
        root = np.sqrt(weight) / expected
        solution = np.linalg.lstsq(design * root[:, None], sigma * root, rcond=None)[0]
        fitted = design @ solution
        expected = np.maximum(fitted, np.maximum(0.2 * sigma, _SMALLEST))
    residual = float(np.sum(weight * ((sigma - fitted) / expected) ** 2) / weight.sum())
    values = dict.fromkeys(NAMES, 0.0) | {'n': float(n)}
    return values | {name: float(x) for name, x in zip(names, solution, strict=True)}, residual


def _evaluate(values: dict[str, float], z: np.ndarray, slant: np.ndarray) -> np.ndarray:
    return (
        values['a'] + values['b'] * z + values['c'] * z**2 + values['d'] * z ** values['n'] * slant
    )


def _gradient(values: dict[str, float], z: np.ndarray, slant: np.ndarray) -> np.ndarray:
    power = z ** values['n'] * slant
    return np.stack([np.ones_like(z), z, z**2, power, values['d'] * power * np.log(z)], axis=1)


def _jackknife(
    values: dict[str, float],
    free: list[str],
    z: np.ndarray,
    slant: np.ndarray,
    sigma: np.ndarray,
    weight: np.ndarray,
    group: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Return the covariance of the coefficients, from fits without one recording each."""
    columns = [NAMES.index(name) for name in free]
    model = _evaluate(values, z, slant)
    root = np.sqrt(weight) / np.maximum(model, np.maximum(0.2 * sigma, _SMALLEST))
    jacobian = (_gradient(values, z, slant) * root[:, None])[:, columns]
    residual = (sigma - model) * root
    groups = int(group.max()) + 1
    covariance = np.zeros((5, 5))
    freedom = groups - len(columns)
    if freedom < 1:
        return covariance, 0
    normal = jacobian.T @ jacobian
    spread = np.zeros((len(columns), len(columns)))
    for g in range(groups):
        own = jacobian[group == g]
        change = np.linalg.pinv(normal - own.T @ own) @ (own.T @ residual[group == g])
        spread += np.outer(change, change)
    covariance[np.ix_(columns, columns)] = spread * (groups - 1) / groups
    return covariance, freedom


def _quantile(freedom: int) -> float:
    return float(stats.t.ppf(0.5 + CONFIDENCE / 2, freedom))

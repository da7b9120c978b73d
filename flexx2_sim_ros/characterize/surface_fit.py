"""Fit how noise depends on reflectivity, from boards of several reflectivities."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.axial_fit import AxialFit
from flexx2_sim_ros.characterize.tiles import Tiles
from flexx2_sim_ros.profiles.modes import NoiseModel, SurfaceNoise
import numpy as np
from scipy.optimize import least_squares

NAMES = ('constant_share', 'read_share')
FEWEST_BOARDS = 3
_START = 0.1, 0.5
_SMALLEST = 1e-9  # metres: what never changed has no relative error


@dataclass(frozen=True)
class SurfaceFit:
    """
    How one mode's noise depends on reflectivity.

    Attributes
    ----------
    errors : dict of str to float or None
        Standard errors of the coefficients, `noise`; None where too few recordings say how sure
        one is.
    reflectivities : tuple of float
        Of the boards, falling; the first is the white board's.
    scatter : float
        Root mean square relative deviation of the darker boards' noise from the model.
    notes : tuple of str
        What a person should know.

    """

    noise: SurfaceNoise
    errors: dict[str, float | None]
    reflectivities: tuple[float, ...]
    scatter: float
    notes: tuple[str, ...]


def fit_surfaces(
    recordings: list[Tiles], reflectivity: list[float], axial: AxialFit
) -> SurfaceFit:
    """
    Fit the dependence to the darker boards, relative to the model that fits the white one.

    Residuals are relative and every recording weighs the same, as in `fit_axial`. Standard errors
    come from leaving out one recording after another, and from those of ``axial``, which is of the
    recordings with the highest reflectivity. ``reflectivity`` of each recording's board is 0..1,
    with at least `FEWEST_BOARDS` different ones.
    """
    boards = sorted(set(reflectivity), reverse=True)
    white = boards[0]
    dark = [
        (tiles, rho) for tiles, rho in zip(recordings, reflectivity, strict=True) if rho < white
    ]
    best = _solve(dark, axial.coefficients, white, _START)
    without = [
        _solve(dark[:i] + dark[i + 1 :], axial.coefficients, white, best) for i in range(len(dark))
    ]
    freedom = len(dark) - len(NAMES)
    errors: dict[str, float | None] = dict.fromkeys(NAMES)
    if freedom > 0 and axial.freedom > 0:
        changes = np.array(without) - best
        variance = (changes**2).sum(axis=0) * (len(dark) - 1) / len(dark)
        variance += _variance_by_axial(dark, axial, white, best)
        errors = {name: math.sqrt(v) for name, v in zip(NAMES, variance, strict=True)}
    noise = SurfaceNoise(white, *(float(x) for x in best))
    ratios = [
        math.sqrt(
            np.average(tiles.variance, weights=tiles.pixels)
            / np.average(_sigma(tiles, rho, axial.coefficients, noise) ** 2, weights=tiles.pixels)
        )
        for tiles, rho in dark
    ]
    held = [name for name, x in zip(NAMES, best, strict=True) if x < 1e-6 or x > 1 - 1e-6]
    return SurfaceFit(
        noise,
        errors,
        tuple(boards),
        float(np.sqrt(np.mean((np.array(ratios) - 1) ** 2))),
        tuple(f'{name}: the best value is at the end of 0..1' for name in held),
    )


def _solve(
    dark: list[tuple[Tiles, float]],
    coefficients: dict[str, float],
    white: float,
    start: tuple[float, ...],
) -> tuple[float, float]:
    measured = [_unbiased_sigma(tiles) for tiles, _ in dark]
    weights = [np.sqrt(tiles.pixels / tiles.pixels.sum()) for tiles, _ in dark]

    def residuals(shares: np.ndarray) -> np.ndarray:
        noise = SurfaceNoise(white, float(shares[0]), float(shares[1]))
        return np.concatenate(
            [
                weight * (sigma / _sigma(tiles, rho, coefficients, noise) - 1)
                for (tiles, rho), sigma, weight in zip(dark, measured, weights, strict=True)
            ]
        )

    inside = np.clip(start, 0.001, 0.999)
    constant, read = least_squares(residuals, inside, bounds=(0.0, 1.0), x_scale=0.1).x
    return float(constant), float(read)


def _sigma(
    tiles: Tiles, rho: float, coefficients: dict[str, float], noise: SurfaceNoise
) -> np.ndarray:
    model = NoiseModel(**coefficients, sigma_x=0.0, surfaces=noise)
    theta = np.where(np.isfinite(tiles.theta), tiles.theta, 0.0)
    return np.maximum(model.sigma_z(tiles.z, theta, rho), _SMALLEST)


def _unbiased_sigma(tiles: Tiles) -> np.ndarray:
    # A sample's standard deviation is too small by a share of 1 / (4 freedom) on average.
    sigma: np.ndarray = np.sqrt(tiles.variance) * (1 + 1 / (4 * tiles.freedom))
    return sigma


def _variance_by_axial(
    dark: list[tuple[Tiles, float]], axial: AxialFit, white: float, best: tuple[float, float]
) -> np.ndarray:
    # The fit once more, with the axial coefficients one standard error off in each independent
    # direction.
    names = list(axial.coefficients)
    values, directions = np.linalg.eigh(axial.covariance)
    total = np.zeros(len(NAMES))
    for value, direction in zip(values, directions.T, strict=True):
        if value > 0:
            step = math.sqrt(value) * direction
            moved = {
                name: axial.coefficients[name] + float(one)
                for name, one in zip(names, step, strict=True)
            }
            total += (np.array(_solve(dark, moved, white, best)) - best) ** 2
    return total

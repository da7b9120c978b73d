"""What fits share: robust weights, damped Gauss-Newton steps, sums for covariances."""

from typing import Protocol, Self, TypeVar

from flexx2_sim_ros.physics.poses import weighted_equations
import numpy as np

# The standard deviation of normally distributed errors whose median absolute value is 1.
PER_MEDIAN = 1.4826
TRUNCATION = 0.1  # metres: larger residuals are truncated to this
_CAUCHY = 1.5  # standard deviations of the residuals: the scale of the loss
_LEAST_SCALE = 0.0005  # metres: no mesh is better
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-6, 1e3
_ROUNDING = 1e-6  # of the loss


class State(Protocol):
    """What is fitted, as one step has it."""

    def step(self, damping: float) -> np.ndarray | None:
        """Return the step that its linear equations ask for; None where they are too few."""

    def moved(self, step: np.ndarray) -> Self:
        """Return the state after a step."""

    def loss(self, other: Self) -> float:
        """Return the loss of a state, by the scale of this one."""


_State = TypeVar('_State', bound=State)


def minimise(start: _State, steps: int, small: float, damping: float = _FIRST_DAMPING) -> _State:
    """Return the state of least loss after so many steps, or when a step is small; 0: undamped."""
    here = start
    for _ in range(steps):
        step = here.step(damping)
        if step is None:
            break
        there = here.moved(step)
        if here.loss(there) <= here.loss(here) * (1 + _ROUNDING):
            here, damping = there, max(damping / 10, min(damping, _LEAST_DAMPING))
        else:
            damping *= 10
            if not 0 < damping <= _MOST_DAMPING:
                break
        if np.abs(step).max(initial=0) < small:
            break
    return here


def damped_step(
    J: np.ndarray,  # noqa: N803
    weight: np.ndarray,
    residual: np.ndarray,
    damping: float,
) -> np.ndarray:
    """Return the (k,) step of (N, k) slopes, (N,) weights and residuals."""
    H, g = weighted_equations(J.T, weight, residual)  # noqa: N806
    if not damping:
        return np.asarray(np.linalg.lstsq(H, g, None)[0])
    return np.asarray(np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9), g))


def tile_sums(tile: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (tiles, k) sums of (N, k) values: errors within a tile are not independent."""
    out = np.zeros((int(tile.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(out, tile, values)
    return out


def blocks(image: np.ndarray, side: int) -> np.ndarray:
    """Return (N, side * side) the values in each whole square block of an (H, W) image."""
    height, width = (size - size % side for size in image.shape)
    rows = image[:height, :width].reshape(height // side, side, width // side, side)
    return rows.swapaxes(1, 2).reshape(-1, side * side)


def robust_sigma(errors: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the standard deviation of errors about 0, by their median absolute value."""
    return np.asarray(PER_MEDIAN * np.nanmedian(np.abs(errors), axis=axis))


def robust_weights(
    residual: np.ndarray, variance: np.ndarray | float, widest: float, sigmas: float = _CAUCHY
) -> np.ndarray:
    """Return (N,) weights of a Cauchy loss, of a scale up to `widest`, metres; 0 for NaN."""
    good = np.isfinite(residual)
    if not good.any():
        return np.zeros(len(residual))
    scale2 = np.clip(sigmas * robust_sigma(residual), _LEAST_SCALE, widest) ** 2 + variance
    return np.where(good, 1 / (scale2 + np.nan_to_num(residual) ** 2), 0.0)

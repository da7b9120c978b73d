"""
Weighted normal equations: values that recordings share, and nuisances of each recording's own.

Arrays have these axes: R recordings, S shared values, N nuisances of each recording (its pose
error, its brightness, its edges) and F features. `physics.poses` eliminates the nuisances.
"""

from flexx2_sim_ros.gap.calibration.inference import LOSS
from flexx2_sim_ros.physics.poses import SharedEquations
import numpy as np


def cauchy_weights(weights: np.ndarray, residual: np.ndarray, scale2: np.ndarray) -> np.ndarray:
    """
    Return (R, F) weights of iteratively reweighted least squares for Cauchy's loss.

    With the loss ``log(1 + r^2 / s^2)`` a feature counts ``1 / (s^2 + r^2)``, so that an outlier
    hardly counts. `weights` is how much each feature counts, 0 where it is unknown; `scale2` the
    squared scale of the loss. All are (R, F). Huber, Robust Statistics, 1981, chapter 7, defines
    M-estimators; Holland and Welsch, Robust regression using iteratively reweighted least-squares,
    Communications in Statistics 6(9), 1977, give the algorithm and the weights.
    """
    return weights / (scale2 + residual**2)


def normal_equations(
    design: np.ndarray, weight: np.ndarray, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return each recording's matrix, (R, P, P), and right side, (R, P), float64.

    `design` is (R, P, F), the change of the features with each of P parameters; `weight` and
    `residual` are (R, F).
    """
    weighted = design * weight[:, None]
    normal = (weighted @ design.transpose(0, 2, 1)).astype(float)
    right = (weighted @ residual[..., None])[..., 0].astype(float)
    return normal, right


def solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve normal equations, (P, P) and (P,), parameters scaled alike; P may be 0."""
    if not len(right):
        return right
    size = np.maximum(np.sqrt(np.diag(matrix)), 1e-12)
    scaled = matrix / np.outer(size, size) + LOSS.ridge * np.eye(len(right))
    return np.asarray(np.linalg.solve(scaled, right / size) / size)


def solve_given_last(matrix: np.ndarray, right: np.ndarray, last: float) -> np.ndarray:
    """Solve (P, P) and (P,) for all parameters but the last one, whose value is given."""
    rest = len(right) - 1
    return solve(matrix[:rest, :rest], right[:rest] - matrix[:rest, rest] * last)


def leave_one_out_steps(equations: SharedEquations, last: float) -> np.ndarray:
    """
    Return (R, S - 1) steps of the shared values without each recording, the last step given.

    One step of the common fit, in its last iteration, with a recording's equations taken off
    stands for a whole fit without that recording: Pregibon, Logistic regression diagnostics,
    Annals of Statistics 9(4), 1981, the one-step approximation.
    """
    normal, right = equations.normal, equations.right
    all_normal, all_right = normal.sum(axis=0), right.sum(axis=0)
    return np.array(
        [
            solve_given_last(all_normal - own, all_right - aim, last)
            for own, aim in zip(normal, right, strict=True)
        ]
    )

"""How well a recording's ground truth is known: where, how accurately, within which bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from flexx2_sim_ros.errors import InputError
import numpy as np

_ROUNDING = 1e-6  # relative asymmetry, and negative eigenvalues, that rounding leaves
_MOST_METRES = 10.0
_ALONG = 0.995  # cosine: a plane's normal and the image's x axis are the same
KEYS = ('known', 'clean_sigma', 'pose_covariance', 'plane', 'plane_covariance', 'plane_names')


@dataclass(frozen=True)
class Truth:
    """
    What a recording says of its `clean_depth`.

    Attributes
    ----------
    known : numpy.ndarray or None
        (H, W) or (T, H, W) bool: where `clean_depth` is known, as a depth or (NaN) as no return;
        None where it is known everywhere.
    clean_sigma : numpy.ndarray or None
        (), (H, W) or (T, H, W) float32, metres: its standard deviation, pixel by pixel.
    pose_covariance : numpy.ndarray or None
        (6, 6) float64 of the camera's pose: x, y, z in metres and a rotation vector in radians, in
        the optical frame.
    plane : numpy.ndarray or None
        (H, W) uint8: 0 for no plane, k for the k-th plane.
    plane_covariance : numpy.ndarray or None
        (3 P, 3 P) float64 of the planes' parameters: an offset along the normal in metres and two
        tilts in radians for each.
    plane_names : tuple of str
        Of the P planes, for reports; empty where they have none.

    """

    known: np.ndarray | None = None
    clean_sigma: np.ndarray | None = None
    pose_covariance: np.ndarray | None = None
    plane: np.ndarray | None = None
    plane_covariance: np.ndarray | None = None
    plane_names: tuple[str, ...] = ()

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the keys of the recording format; what is None or empty is left out."""
        values = {key: getattr(self, key) for key in KEYS if key != 'plane_names'}
        if self.plane_names:
            values['plane_names'] = np.array(self.plane_names)
        return {key: np.asarray(value) for key, value in values.items() if value is not None}


@dataclass(frozen=True)
class Accuracy:
    """A recording's ground truth in a few numbers, each None where the recording does not say."""

    unknown: float = 0.0  # fraction of the pixels
    sigma: float | None = None  # median of `clean_sigma` where known, metres
    # Root mean square standard deviation of the pose, metres and degrees an axis:
    pose: float | None = None
    turn: float | None = None
    planes: int = 0  # with constraints instead of values; and of their parameters:
    offset: float | None = None
    tilt: float | None = None


def plane_axes(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the axes, each (3,), that a plane's two tilts are about; tilts are right-handed.

    ``normal`` is (3,), unit, away from the camera, in the optical frame. The first axis is the
    image's x axis projected onto the plane (its y axis, where the plane faces along x), the second
    normal x the first.
    """
    axis = np.eye(3)[0 if abs(normal[0]) < _ALONG else 1]
    first = axis - (axis @ normal) * normal
    first = first / np.linalg.norm(first)
    return first, np.cross(normal, first)


def accuracy_of(truth: Truth) -> Accuracy:
    """Return how accurate a recording's ground truth is."""
    known, sigma, planes = truth.known, truth.clean_sigma, truth.plane_covariance
    if sigma is not None and known is not None and known.ndim <= sigma.ndim:
        sigma = sigma[np.broadcast_to(known, sigma.shape)]
    pose = None if truth.pose_covariance is None else np.diag(truth.pose_covariance)
    plane = None if planes is None or not len(planes) else np.diag(planes).reshape(-1, 3)
    return Accuracy(
        0.0 if known is None else float(1 - known.mean()),
        None if sigma is None or not sigma.size else float(np.median(sigma)),
        None if pose is None else _root(pose[:3]),
        None if pose is None else float(np.degrees(_root(pose[3:]))),
        0 if plane is None else len(plane),
        None if plane is None else _root(plane[:, 0]),
        None if plane is None else float(np.degrees(_root(plane[:, 1:]))),
    )


def _root(variances: np.ndarray) -> float:
    return float(np.sqrt(np.maximum(variances, 0).mean()))


def read_truth(path: Path, arrays: Mapping[str, np.ndarray], shape: tuple[int, int, int]) -> Truth:
    """
    Check and return the keys of a recording that say how well its ground truth is known.

    ``shape`` is (T, H, W) of its depth. Raises InputError, which names file and key, when one of
    them has a wrong shape, dtype or value.
    """
    known = arrays.get('known')
    if known is not None and (known.dtype != bool or known.shape not in (shape, shape[1:])):
        raise _wrong(path, 'known', f'bool {shape[1:]} or {shape}', known)
    plane, covariance = arrays.get('plane'), arrays.get('plane_covariance')
    if plane is not None and (plane.dtype != np.uint8 or plane.shape != shape[1:]):
        raise _wrong(path, 'plane', f'uint8 {shape[1:]}', plane)
    if (plane is None) != (covariance is None):
        one, other = ('plane_covariance', 'plane')[:: 1 if plane is not None else -1]
        raise InputError(f'{path}: {one}: must be given where {other} is, got none')
    count = 0 if plane is None else int(plane.max(initial=0))
    if covariance is not None:
        count = max(count, covariance.shape[0] // 3 if covariance.ndim else 0)
        covariance = _covariance(path, 'plane_covariance', covariance, 3 * count)
    pose = arrays.get('pose_covariance')
    names = arrays.get('plane_names')
    if names is not None and (names.dtype.kind != 'U' or names.shape != (count,)):
        raise _wrong(path, 'plane_names', f'strings ({count},), one for each plane', names)
    return Truth(
        known,
        _sigma(path, arrays.get('clean_sigma'), known, shape),
        None if pose is None else _covariance(path, 'pose_covariance', pose, 6),
        plane,
        covariance,
        () if names is None else tuple(str(name) for name in names),
    )


def _sigma(
    path: Path, sigma: np.ndarray | None, known: np.ndarray | None, shape: tuple[int, ...]
) -> np.ndarray | None:
    if sigma is None:
        return None
    if sigma.dtype.kind not in 'fiu' or sigma.shape not in ((), shape[1:], shape):
        raise _wrong(path, 'clean_sigma', f'metres (), {shape[1:]} or {shape}', sigma)
    # What it says of unknown pixels does not matter.
    used = np.atleast_1d(sigma)
    if known is not None and known.ndim <= sigma.ndim:
        used = sigma[np.broadcast_to(known, sigma.shape)]
    if used.size and not ((used >= 0) & (used <= _MOST_METRES)).all():
        raise InputError(
            f'{path}: clean_sigma: must be 0 to {_MOST_METRES:g} m, got {np.min(used):g} to '
            f'{np.max(used):g}'
        )
    return sigma.astype(np.float32)


def _covariance(path: Path, key: str, matrix: np.ndarray, size: int) -> np.ndarray:
    if matrix.dtype.kind not in 'fiu' or matrix.shape != (size, size):
        raise _wrong(path, key, f'numbers ({size}, {size})', matrix)
    matrix = matrix.astype(np.float64)
    if not np.isfinite(matrix).all():
        raise InputError(f'{path}: {key}: must be finite, got a number that is not')
    limit = _ROUNDING * float(np.abs(matrix).max(initial=0))
    if np.abs(matrix - matrix.T).max(initial=0) > limit:
        raise InputError(f'{path}: {key}: must be symmetric, got a matrix that is not')
    # Metres and radians differ in size: judged as correlations.
    size_of = np.sqrt(np.maximum(np.diag(matrix), 0))
    scaled = matrix / np.outer(*[np.where(size_of > 0, size_of, 1)] * 2)
    lowest = float(np.linalg.eigvalsh(scaled).min(initial=0))
    if lowest < -_ROUNDING:
        raise InputError(
            f'{path}: {key}: must be positive semi-definite, got an eigenvalue of {lowest:.2g} '
            'of the correlations'
        )
    return (matrix + matrix.T) / 2


def _wrong(path: Path, key: str, wanted: str, found: np.ndarray) -> InputError:
    return InputError(f'{path}: {key}: must be {wanted}, got {found.dtype} of shape {found.shape}')

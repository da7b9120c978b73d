"""Kinds of ground truth in place of the exact one of a simulated campaign: see `TRUTHS`."""

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.gap.data.unknown import plane_shifts
import numpy as np
from scipy import ndimage
from study.blind.partial_truth import known_part

_LEAST = 0.015  # fraction of the image that a plane must cover
_TRIES = 300
TAPE, SQUARE = 0.003, 0.3  # metres, degrees: accuracy of a plane measured by hand
LOOSE = 0.1, 5.0  # without a measurement


def hide(content, seed):
    """Return a recording with its edges and some patches unknown, about 30 % of the image."""
    clean = content['clean_depth']
    known = known_part(clean, seed)
    return {**content, 'known': known, 'clean_depth': np.where(known, clean, np.float32(np.nan))}


def constrain(content, seed):
    """Return a recording with planes as measured by a tape measure and a set square."""
    return _as_planes(content, content['clean_depth'], 0.001, TAPE, SQUARE, seed, exact=False)


def fit_planes(content, seed):
    """Return a recording with planes that are only fitted to its own frames."""
    depth = np.nanmedian(content['depth'], axis=0)
    return _as_planes(content, depth, 0.012, *LOOSE, seed, exact=True)


def fit_as_exact(content, seed):
    """Return a recording with planes fitted to its frames, declared exact."""
    out = fit_planes(content, seed)
    return {key: value for key, value in out.items() if not key.startswith('plane')}


def exact(content, seed):
    """Return the recording unchanged."""
    return content


# `masked`: edges and some patches are unknown, about 30 %. `constrained`: planes that a tape
# measure and a set square constrain. `fitted`: planes fitted to the recorded frames, given as
# loose, or as exact.
TRUTHS = {
    'exact': exact,
    'masked': hide,
    'constrained': constrain,
    'fitted': fit_planes,
    'fitted as exact': fit_as_exact,
}


def _as_planes(content, depth, tolerance, offset, degrees, seed, exact):
    # Planes (p = a u + b v + c in inverse depth) that depth contains; other pixels are unknown.
    rng = np.random.default_rng(seed)
    plane, clean = find_planes(depth, tolerance, rng)
    count = int(plane.max())
    std = np.tile([offset, np.radians(degrees), np.radians(degrees)], count)
    if not exact:
        height, width = clean.shape
        lens = Intrinsics.from_matrix(content['K'], width, height)
        shifts = plane_shifts(clean, plane, lens, count, plane > 0)
        clean = clean + np.tensordot(rng.standard_normal(3 * count) * std, shifts, axes=1)
    known = plane > 0
    return {
        **content,
        'clean_depth': np.where(known, clean, np.nan).astype(np.float32),
        'known': known,
        'plane': plane,
        'plane_covariance': np.diag(std**2),
    }


def find_planes(depth, tolerance, rng):
    """
    Find planes in a depth image by RANSAC.

    * `depth`: (H, W) metres, NaN where invalid
    * `tolerance`: largest distance of a pixel from its plane, metres

    Returns (H, W) uint8 planes, 0 for none; (H, W) float64 their depth, NaN for none.
    """
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    columns = np.stack([u, v, np.ones_like(u)], -1).astype(float)
    plane, fitted = np.zeros(depth.shape, np.uint8), np.full(depth.shape, np.nan)
    for number in range(1, 9):
        free = np.isfinite(depth) & (plane == 0)
        places = np.argwhere(free)
        if len(places) < 3:
            break
        best = np.zeros(depth.shape, bool)
        for _ in range(_TRIES):
            first = places[rng.integers(len(places))]
            near = places[np.abs(places - first).max(axis=1) < 12]
            some = tuple(near[rng.integers(len(near), size=3)].T)
            inside = free & _near(columns, columns[some], depth[some], depth, tolerance)
            best = inside if inside.sum() > best.sum() else best
        best = ndimage.binary_opening(best)
        if best.sum() < _LEAST * depth.size:
            break
        for _ in range(3):
            inverse = np.linalg.lstsq(columns[best], 1 / depth[best], rcond=None)[0]
            best = free & (np.abs(1 / (columns @ inverse) - depth) < tolerance)
            best = ndimage.binary_opening(best)
        plane[best] = number
        fitted[best] = 1 / (columns[best] @ inverse)
    return plane, fitted


def _near(columns, some, values, depth, tolerance):
    inverse = np.linalg.lstsq(some, 1 / values, rcond=None)[0]
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray(np.abs(1 / (columns @ inverse) - depth) < tolerance)


def rewrite(folder, truth, seed=0):
    """Replace the ground truth of all recordings of a campaign."""
    for i, path in enumerate(sorted(folder.glob('*.npz'))):
        with np.load(path) as archive:
            content = dict(archive)
        np.savez(path, **TRUTHS[truth](content, 1000 * seed + i))

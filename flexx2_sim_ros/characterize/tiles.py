"""
A region's noise in small tiles: what the fit is made of, and its divergence from the model.

Within a tile distance and incidence are as good as the same, so a few sums say all about it.
"""

from dataclasses import dataclass, fields, replace
from functools import cache
import math
from typing import Any, NamedTuple

from flexx2_sim_ros.characterize.board_finding import Board
from flexx2_sim_ros.characterize.moments import Moments
import numpy as np
from scipy.special import digamma


def gaussian_kl(variance: Any, mean_square: Any, log_variance: Any, sigma: Any) -> np.ndarray:
    """
    Return the divergence, nats, of a measured Gaussian from the model's of mean 0 and `sigma`.

    The measured variance, square of the mean and natural logarithm of the variance may be means
    over pixels of one and the same `sigma`: then it is the mean over these. 0 where both are the
    same.
    """
    sigma2 = np.square(sigma)
    return 0.5 * (
        (np.asarray(variance) + mean_square) / sigma2 - 1.0 - log_variance + np.log(sigma2)
    )


def kl_floor(count: Any) -> np.ndarray:
    """
    Return what the divergence of one pixel is on average for a perfect model.

    `count` frames do not fix a mean and a variance better than this: about 1 / count. Taken off
    a measured divergence it leaves what is the model's.
    """
    count = np.asarray(count, np.float64)
    half = np.maximum(count - 1.0, 1.0) / 2.0
    return 0.5 * (1.0 / np.maximum(count, 1.0) + np.log(half) - digamma(half))


_LARGEST_NUMBER = 4000  # of tiles in an image
_SIDE = 4
SPATIAL_SIDE = 8
_WHOLE_SHARE = 0.9  # of a spatial tile that must be valid
_EVEN_RATIO = 1.5  # of the 95th to the 5th percentile of amplitude in a spatial tile
_MOST_CORRELATION = 0.9  # of neighbours; beyond that a tile shows too little (design)
_SMALLEST_VARIANCE = 1e-16  # (10 nm)^2, for the logarithm of what never changed


@dataclass(frozen=True)
class Tiles:
    """
    Parallel arrays, (N,) float64, one entry a tile.

    Attributes
    ----------
    z : numpy.ndarray
        Depth of the plane, metres.
    theta : numpy.ndarray
        Incidence angle, radians; NaN where the camera matrix is not known.
    pixels : numpy.ndarray
        How many pixels went in.
    freedom : numpy.ndarray
        Degrees of freedom of `variance`.
    variance : numpy.ndarray
        Mean variance of depth, m^2.
    log_variance : numpy.ndarray
        Mean over pixels of the logarithm of their variance.
    mean_square : numpy.ndarray
        Mean over pixels of the square of (mean depth - plane), m^2.
    floor : numpy.ndarray
        Mean over pixels of `kl_floor`, nats.
    amplitude : numpy.ndarray
        Median amplitude, in the camera's units; NaN where there is none.
    neighbours : numpy.ndarray
        Mean product of what the tile's plane leaves of neighbouring pixels, m^2; NaN for tiles
        over frames.

    """

    z: np.ndarray
    theta: np.ndarray
    pixels: np.ndarray
    freedom: np.ndarray
    variance: np.ndarray
    log_variance: np.ndarray
    mean_square: np.ndarray
    floor: np.ndarray
    amplitude: np.ndarray
    neighbours: np.ndarray

    def __len__(self) -> int:
        """Return how many tiles there are."""
        return len(self.z)

    def take(self, which: np.ndarray) -> 'Tiles':
        """Return some of the tiles."""
        return Tiles(*(getattr(self, field.name)[which] for field in fields(self)))


def join(parts: list[Tiles]) -> Tiles:
    """Return the tiles of several recordings as one."""
    return Tiles(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Tiles))
    )


def temporal_tiles(
    board: Board, moments: Moments, amplitude: np.ndarray | None, usable: np.ndarray
) -> Tiles:
    """
    Gather noise over frames, in the region of `board`.

    ``amplitude`` is the (H, W) mean or None; ``usable`` (H, W) bool are pixels with enough valid
    frames.
    """
    height, width = board.mask.shape
    side = max(_SIDE, math.ceil(math.sqrt(height * width / _LARGEST_NUMBER)))
    v, u = np.nonzero(board.region & usable)
    number = (v // side) * (width // side + 1) + u // side
    _, index = np.unique(number, return_inverse=True)
    pixels = np.bincount(index).astype(np.float64)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(index, values) / pixels

    count, variance = moments.count[v, u], moments.variance[v, u]
    plane = board.plane.depth(u, v)
    theta = np.full(len(u), np.nan) if board.K is None else board.plane.incidence(u, v, board.K)
    level = np.full(len(u), np.nan) if amplitude is None else amplitude[v, u]
    freedom = np.bincount(index, count - 1.0)
    return Tiles(
        mean(plane),
        mean(theta),
        pixels,
        freedom,
        np.bincount(index, variance * (count - 1.0)) / freedom,
        mean(np.log(np.maximum(variance, _SMALLEST_VARIANCE))),
        mean((moments.mean[v, u] - plane) ** 2),
        mean(kl_floor(count)),
        mean(level),
        np.full(len(pixels), np.nan),
    )


def spatial_tiles(board: Board, depth: np.ndarray, amplitude: np.ndarray | None) -> Tiles:
    """
    Gather noise within one frame: what is left of a small plane fitted to each tile.

    A fixed pattern counts as noise. Correlated neighbours hide noise from it, see `whole_noise`.
    Tiles of uneven amplitude are left out: their surface is not one. ``depth`` is (H, W) metres,
    NaN where invalid, ``amplitude`` (H, W) or None.
    """
    # Half overlapping, for twice the sides that a checkered board gets right.
    half = SPATIAL_SIDE // 2
    return join(
        [
            _spatial_grid(board, depth, amplitude, down, right)
            for down in (0, half)
            for right in (0, half)
        ]
    )


def whole_noise(tiles: Tiles) -> Tiles:
    """
    Return spatial tiles of one recording with the noise that fitted planes hide.

    They hide that of correlated pixels. The correlation is assumed to fall with distance like that
    of noise behind a Gaussian filter, the same in all directions: of pixels u columns and v rows
    apart it is r ** (u * u + v * v). The r that leaves the measured correlation of neighbours in
    the tiles is taken. Changed are the variance, and its degrees of freedom to those that
    correlated pixels have (Satterthwaite's approximation).
    """
    table = _correlated()
    measured = float(np.sum(tiles.neighbours) / np.sum(tiles.variance))
    seen, effective = (
        float(np.interp(measured, table.neighbours, column))
        for column in (table.seen, table.effective)
    )
    return replace(
        tiles,
        variance=tiles.variance / seen,
        log_variance=tiles.log_variance - math.log(seen),
        freedom=tiles.freedom * effective,
    )


class _Correlated(NamedTuple):
    # What planes fitted to tiles leave of noise of variance 1, (N,) each by its correlation:
    # covariance of neighbours relative to the variance that is left, that variance, and its
    # degrees of freedom relative to those of independent pixels.
    neighbours: np.ndarray
    seen: np.ndarray
    effective: np.ndarray


@cache
def _correlated() -> _Correlated:
    rows, columns = np.mgrid[:SPATIAL_SIDE, :SPATIAL_SIDE].reshape(2, -1)
    apart = sum(np.subtract.outer(place, place) ** 2 for place in (rows, columns))
    design = np.stack([np.ones_like(rows), rows, columns], axis=1).astype(np.float64)
    residual = np.eye(len(design)) - design @ np.linalg.pinv(design)
    freedom = len(design) - design.shape[1]
    found = []
    for correlation in np.linspace(0.0, _MOST_CORRELATION, 46):
        left = residual @ correlation**apart @ residual
        variance = np.trace(left) / freedom
        found.append(
            (
                left[apart == 1].mean() / variance,
                variance,
                np.trace(left) ** 2 / np.trace(left @ left) / freedom,
            )
        )
    return _Correlated(*np.array(found).T)


def _spatial_grid(
    board: Board, depth: np.ndarray, amplitude: np.ndarray | None, down: int, along: int
) -> Tiles:
    side = SPATIAL_SIDE
    region = board.region[down:, along:]
    blocks = _blocks(np.where(region, depth[down:, along:], np.nan), side)
    valid = np.isfinite(blocks)
    good = (valid.mean(axis=1) >= _WHOLE_SHARE) & _blocks(region, side).all(axis=1)
    level = np.full(len(blocks), np.nan)
    if amplitude is not None:
        levels = _blocks(np.asarray(amplitude[down:, along:], np.float64), side)
        low, level, high = np.percentile(levels, (5, 50, 95), axis=1)
        good &= high <= _EVEN_RATIO * low
    blocks, valid, level = blocks[good], valid[good], level[good]
    v, u = np.mgrid[:side, :side].reshape(2, -1) - (side - 1) / 2
    design = np.stack([np.ones_like(u), u, v], axis=1)
    # A least-squares plane in each block: three equations each, all at once.
    weights = valid.astype(np.float64)
    values = np.where(valid, blocks, 0.0)
    normal = np.einsum('bi,ij,ik->bjk', weights, design, design)
    right = np.einsum('bi,ij->bj', values, design)
    fitted = np.linalg.solve(normal, right[..., None])[..., 0]
    residual = np.where(valid, blocks - fitted @ design.T, 0.0)
    freedom = weights.sum(axis=1) - 3.0
    variance = np.maximum((residual**2).sum(axis=1) / freedom, _SMALLEST_VARIANCE)
    rows, columns = np.nonzero(good.reshape([length // side for length in region.shape]))
    middle_u = (columns + 0.5) * side - 0.5 + along
    middle_v = (rows + 0.5) * side - 0.5 + down
    theta = (
        np.full(len(blocks), np.nan)
        if board.K is None
        else board.plane.incidence(middle_u, middle_v, board.K)
    )
    return Tiles(
        board.plane.depth(middle_u, middle_v),
        theta,
        weights.sum(axis=1),
        freedom,
        variance,
        np.log(variance),
        np.zeros(len(blocks)),
        kl_floor(freedom + 1.0) - 0.5 / (freedom + 1.0),
        level,
        _products(residual, weights),
    )


def _products(residual: np.ndarray, valid: np.ndarray) -> np.ndarray:
    # Mean over neighbours in a row or a column, both valid; (N, side * side) each.
    shape = len(residual), SPATIAL_SIDE, SPATIAL_SIDE
    residual, valid = residual.reshape(shape), valid.reshape(shape)
    pairs = [(np.s_[:, :, 1:], np.s_[:, :, :-1]), (np.s_[:, 1:], np.s_[:, :-1])]
    total, count = (
        sum((image[one] * image[other]).sum(axis=(1, 2)) for one, other in pairs)
        for image in (residual, valid)
    )
    products: np.ndarray = total / count
    return products


def _blocks(image: np.ndarray, side: int) -> np.ndarray:
    height, width = image.shape[0] // side * side, image.shape[1] // side * side
    parts = image[:height, :width].reshape(height // side, side, width // side, side)
    return parts.swapaxes(1, 2).reshape(-1, side * side)

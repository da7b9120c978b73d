"""Find the board in a depth image: the plane in its middle, and the pixels safely on it."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.plane import fit_plane, Plane, ransac_plane, straighten
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np
from scipy import ndimage

# Fewer pixels than this say nothing about a plane or its noise; of a small image, 8 x 8 for
# instance, this share of its pixels does (design).
_SMALLEST_REGION = 100
_SMALLEST_SHARE = 0.4
# The paper measured up to 60 degrees; the outer part of a board at 60 degrees is steeper (design).
STEEPEST = math.radians(70)
_SEED_SHARE = 0.12  # of the image's width and height: where the board is looked for first
_TOLERANCE_SHARE = 0.01  # of the distance: the camera's depth resolution (paper)
MARGIN_SHARE = 8 / 224  # of the image's width: edges move by up to 5 sigma_x = 8 px (paper)
SMALLEST_MARGIN = 3
_LARGEST_MARGIN = 1 / 8  # of the image's width, for small images (design)
_MAX_SEEDS = 4000


@dataclass(frozen=True)
class Board:
    """
    A board in an image, and the (3, 3) camera matrix or None.

    ``mask`` (H, W) bool are all pixels on it, up to its edges; ``region`` (H, W) bool are those to
    measure: away from the edges and not too steep.
    """

    plane: Plane
    mask: np.ndarray
    region: np.ndarray
    K: np.ndarray | None  # noqa: N815

    @property
    def aim(self) -> tuple[float, float]:
        """Return the place (u, v) of the region nearest to the optical axis, pixels."""
        height, width = self.mask.shape
        cx, cy = ((width - 1) / 2, (height - 1) / 2) if self.K is None else self.K[:2, 2]
        v, u = np.nonzero(self.region)
        away = np.hypot(u - cx, v - cy)
        nearest = int(np.argmin(away))
        return (cx, cy) if away[nearest] < 1 else (float(u[nearest]), float(v[nearest]))


def smallest_region(shape: tuple[int, ...]) -> int:
    """Return how many pixels of an image (H, W) a board must have."""
    return min(_SMALLEST_REGION, math.ceil(_SMALLEST_SHARE * math.prod(shape)))


def find_board(
    depth: np.ndarray,
    noise: float,
    K: np.ndarray | None = None,  # noqa: N803
    box: tuple[int, int, int, int] | None = None,
    margin: int | None = None,
    distortion: tuple[float, ...] = (),
) -> Board:
    """
    Find the board; raises InputError when there is no plane of a useful size there.

    Without a box (x0, y0, x1, y1, with x1 and y1 outside), the plane is looked for in the middle
    of the image and followed as far as it goes; the region ends ``margin`` pixels before the plane
    does, by default as far as edges jump about over many frames. ``depth`` is (H, W) metres, NaN
    where invalid: a median over frames, or a single frame, with the standard deviation ``noise``,
    metres. Without ``K``, the (3, 3) camera matrix, pixels that are too steep cannot be told.
    ``distortion`` is as in `Intrinsics.distortion`; none when left out.
    """
    lens = None
    if K is not None and any(distortion):
        lens = Intrinsics.from_matrix(K, depth.shape[1], depth.shape[0], distortion)
    rows, columns = np.indices(depth.shape)
    seen = np.isfinite(straighten(columns, rows, lens)[0])
    depth = np.where(seen, depth, np.nan)
    valid = np.isfinite(depth)
    tolerance = max(4.0 * noise, _TOLERANCE_SHARE * _median(depth, valid))
    if box is None:
        seed = _middle(valid)
        plane, mask = _grow(depth, valid, seed, tolerance, lens)
        # Another surface seen through a hole is not the board; a noisy or biased pixel is.
        region = _inner(mask, margin) & (~valid | _near(depth, plane, 4 * tolerance))
    else:
        x0, y0, x1, y1 = box
        seed = np.zeros_like(valid)
        seed[y0:y1, x0:x1] = True
        plane, near = _plane_of(depth, valid & seed, tolerance, lens)
        mask = near & seed
        region = ndimage.binary_closing(mask, iterations=2) | mask
        region &= seed
    region &= seen
    v, u = np.nonzero(region)
    if K is not None and len(u):
        region[v, u] = plane.incidence(u, v, K) < STEEPEST
    if region.sum() < smallest_region(depth.shape):
        raise InputError(
            f'board: must have at least {smallest_region(depth.shape)} pixels (a flat board that '
            f'covers the middle, or --box), got {int(region.sum())} pixels of a plane in the '
            f'{"middle" if box is None else "box"} of the image'
        )
    return Board(plane, mask, region, K)


def _median(depth: np.ndarray, valid: np.ndarray) -> float:
    least = smallest_region(depth.shape)
    if valid.sum() < least:
        raise InputError(f'depth: must have at least {least} valid pixels, got {int(valid.sum())}')
    return float(np.median(depth[valid]))


def _middle(valid: np.ndarray) -> np.ndarray:
    """Return a window amid the valid pixels, widened until it has enough of them."""
    height, width = valid.shape
    row, column = (int(np.median(places)) for places in np.nonzero(valid))
    share = _SEED_SHARE
    while True:
        half = max(2, round(share * height / 2)), max(2, round(share * width / 2))
        window = np.zeros_like(valid)
        window[
            max(row - half[0], 0) : row + half[0] + 1,
            max(column - half[1], 0) : column + half[1] + 1,
        ] = True
        if (valid & window).sum() >= smallest_region(valid.shape) / 2 or share >= 2.0:
            return window
        share *= 1.5


def _plane_of(
    depth: np.ndarray, seed: np.ndarray, tolerance: float, lens: Intrinsics | None
) -> tuple[Plane, np.ndarray]:
    v, u = np.nonzero(seed)
    if len(u) < 10:
        raise InputError(
            'board: must be flat and cover the middle of the image (or give --box), got '
            f'{len(u)} valid pixels where it should be'
        )
    thin = slice(None, None, math.ceil(len(u) / _MAX_SEEDS))
    plane = ransac_plane(u[thin], v[thin], depth[v, u][thin], tolerance, lens)
    return plane, _near(depth, plane, tolerance)


def _near(depth: np.ndarray, plane: Plane, tolerance: float) -> np.ndarray:
    v, u = np.indices(depth.shape)
    with np.errstate(invalid='ignore'):
        return np.abs(depth - plane.depth(u, v)) < tolerance


def _grow(
    depth: np.ndarray,
    valid: np.ndarray,
    window: np.ndarray,
    tolerance: float,
    lens: Intrinsics | None,
) -> tuple[Plane, np.ndarray]:
    """Follow the plane in the window as far as it goes."""
    plane, near = _plane_of(depth, valid & window, tolerance, lens)
    for _ in range(3):
        # Single invalid or noisy pixels do not cut the board into pieces.
        whole = ndimage.binary_closing(np.pad(near, 2), iterations=2)[2:-2, 2:-2] | near
        labels, _ = ndimage.label(whole)
        inside = labels[window & near]
        if not inside.any():
            raise InputError(
                'board: must be flat and cover the middle of the image (or give --box), got '
                'no plane there'
            )
        mask = ndimage.binary_fill_holes(labels == np.bincount(inside[inside > 0]).argmax())
        v, u = np.nonzero(mask & near)
        plane = fit_plane(u, v, depth[v, u], lens)
        near = _near(depth, plane, tolerance)
    return plane, mask


def _inner(mask: np.ndarray, margin: int | None) -> np.ndarray:
    """Return the mask without a margin; where it runs out of the image there is no edge."""
    if margin is None:
        margin = max(SMALLEST_MARGIN, round(MARGIN_SHARE * mask.shape[1]))
    margin = min(margin, int(_LARGEST_MARGIN * mask.shape[1]))
    # A square: edges move along rows and columns.
    square = np.ones((2 * margin + 1, 2 * margin + 1), bool)
    return ndimage.binary_erosion(mask, square, border_value=1)

"""Find planes in a depth image, robustly."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.truth.observation import grow, Observation
from flexx2_sim_ros.truth.plane_file import PlaneHint
from flexx2_sim_ros.truth.robust import robust_sigma
import numpy as np
from scipy import ndimage

# A pixel lies on a plane within so many metres and standard deviations of depth. Multipath and
# wiggling bend planes by some centimetres.
_TOLERANCE, _NOISE = 0.02, 3.0
_LEAST = 0.015  # least fraction of the image that a plane covers
_GRAZING = 0.17  # cosine of incidence; 80 degrees
# Random triples, of pixels at most so far apart, judged on so many pixels.
_TRIES, _NEAR, _SAMPLE = 400, 24, 4000
_STEPS = 6
_HOLE = 25  # pixels: smaller holes are noise, larger ones may be objects
_BORDER = 2  # pixels
_FEW = 0.01  # of a plane's pixels may be elsewhere inside it without a note
_PATCH = 4  # pixels around a seed


@dataclass(frozen=True)
class Surface:
    """
    A plane in an image.

    Attributes
    ----------
    name : str
    inverse : numpy.ndarray
        (3,) coefficients: inverse depth is the product with the ray (x/z, y/z, 1).
    mask : numpy.ndarray
        (H, W) bool: pixels on it, away from its borders.

    """

    name: str
    inverse: np.ndarray
    mask: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        """Return the unit normal that points away from the camera, optical frame."""
        return np.asarray(self.inverse / np.linalg.norm(self.inverse))

    @property
    def distance(self) -> float:
        """Return the perpendicular distance from the optical centre, metres."""
        return float(1 / np.linalg.norm(self.inverse))


def find_planes(image: Observation, hints: Sequence[PlaneHint]) -> list[Surface]:
    """
    Find planes: those with a box first, then the largest of the rest.

    Parameters
    ----------
    image : Observation
        The image.
    hints : sequence of PlaneHint
        The planes to find.

    Returns
    -------
    list of Surface
        The planes that were found, in the order of the hints.

    """
    free, search = image.smooth.copy(), _Search(image)
    found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for hint in sorted(hints, key=lambda hint: not hint.box):
        start = free & _inside(hint.box, free.shape) if hint.box else free
        inverse = search.plane(start, free, growing=bool(hint.box))
        if inverse is None:
            continue
        on_it = free & search.near(inverse)
        mask = _tidy(on_it)
        if mask.sum() >= _LEAST * mask.size and (not hint.box or (mask & start).any()):
            found[hint.name] = inverse, mask
            free &= ~on_it
    return [
        Surface(hint.name, found[hint.name][0], mask)
        for hint in hints
        if hint.name in found
        for mask in [_away_from_others(search, hint.name, found)]
        if mask.any()
    ]


def contradicting(image: Observation, surfaces: Sequence[Surface]) -> dict[str, int]:
    """
    Return how many pixels between those of a plane, in a row or column, are not on any plane.

    They are of another thing, or the camera measures them wrong. Planes where this is true of
    hardly a pixel are left out.
    """
    search, out = _Search(image), {}
    others = np.isfinite(image.depth) & ~np.any([one.mask for one in surfaces], axis=0)
    for one in surfaces:
        inside = _between(one.mask, 0) | _between(one.mask, 1)
        count = int((inside & others & ~search.near(one.inverse)).sum())
        if count > _FEW * one.mask.sum():
            out[one.name] = count
    return out


class _Search:
    """Planes among the pixels of an image."""

    def __init__(self, image: Observation) -> None:
        self.image = image
        self.rays = np.concatenate([image.rays, np.ones((*image.depth.shape, 1))], axis=-1)
        self.tolerance = _TOLERANCE + _NOISE * image.sigma

    def near(self, inverse: np.ndarray) -> np.ndarray:
        """Return (H, W) bool: pixels near the plane, except at grazing angles."""
        along = self.rays @ inverse
        cosine = along / np.linalg.norm(inverse) / self.image.length
        with np.errstate(divide='ignore', invalid='ignore'):
            return (np.abs(self.image.depth - 1 / along) < self.tolerance) & (cosine > _GRAZING)

    def plane(self, start: np.ndarray, free: np.ndarray, growing: bool) -> np.ndarray | None:
        """Return the plane with most pixels of ``start``, grown and fitted to its pixels."""
        places = np.argwhere(start)
        if len(places) < 3:
            return None
        inverse = self._best(places)
        if inverse is None:
            return None
        reach = start
        for _ in range(_STEPS):
            reach = free & grow(reach, 8) if growing else free
            inverse = self._fitted(inverse, reach & self.near(inverse))
            if inverse is None:
                return None
        return self._fitted(inverse, free & self.near(inverse))

    def _best(self, places: np.ndarray) -> np.ndarray | None:
        # RANSAC with triples of neighbouring pixels, which are more often on one plane.
        rng = np.random.default_rng(0)
        first = places[rng.integers(len(places), size=_TRIES)]
        height, width = self.image.depth.shape
        shift = rng.integers(-_NEAR, _NEAR + 1, (2, _TRIES, 2))
        others = np.clip(first + shift, 0, np.array([height, width]) - 1)
        triples = np.concatenate([first[None], others]).swapaxes(0, 1)
        allowed = np.zeros((height, width), bool)
        allowed[tuple(places.T)] = True
        triples = triples[allowed[triples[..., 0], triples[..., 1]].all(axis=1)]
        rays = self.rays[triples[..., 0], triples[..., 1]]
        good = np.abs(np.linalg.det(rays)) > 1e-6
        if not good.any():
            return None
        depth = self.image.depth[triples[..., 0], triples[..., 1]]
        planes = np.linalg.solve(rays[good], 1 / depth[good][..., None])[..., 0]
        some = tuple(places[rng.permutation(len(places))[:_SAMPLE]].T)
        along = planes @ self.rays[some].T
        with np.errstate(divide='ignore'):
            near = np.abs(1 / along - self.image.depth[some]) < self.tolerance[some]
        return np.asarray(planes[near.sum(axis=1).argmax()])

    def _fitted(self, inverse: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
        # Gauss-Newton steps in depth with Cauchy weights.
        rays, depth = self.rays[mask], self.image.depth[mask]
        if len(rays) < 3:
            return None
        for _ in range(3):
            clean = 1 / np.maximum(rays @ inverse, 1e-3)
            error = depth - clean
            scale = max(float(robust_sigma(error)), 1e-4)
            weight = 1 / (1 + (error / (2 * scale)) ** 2)
            design = -rays * clean[:, None] ** 2
            step = np.linalg.lstsq(
                (design * weight[:, None]).T @ design, (design * weight[:, None]).T @ error, None
            )[0]
            inverse = inverse + step
        return inverse


def _between(mask: np.ndarray, axis: int) -> np.ndarray:
    # Pixels with some of the mask on both sides.
    back = np.logical_or.accumulate(np.flip(mask, axis), axis=axis)
    return np.asarray(np.logical_or.accumulate(mask, axis=axis) & np.flip(back, axis))


def _inside(box: tuple[float, ...], shape: tuple[int, ...]) -> np.ndarray:
    left, top, right, bottom = box
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(
        (u >= left - _PATCH) & (u <= right + _PATCH) & (v >= top - _PATCH) & (v <= bottom + _PATCH)
    )


def _tidy(mask: np.ndarray) -> np.ndarray:
    # Closes single missing pixels, and removes isolated pixels and the border.
    holes, count = ndimage.label(~mask)
    small = np.bincount(holes.ravel(), minlength=count + 1) <= _HOLE
    small[0] = False
    full = mask | small[holes]
    opened = ndimage.binary_opening(full, np.ones((3, 3), bool), iterations=_BORDER)
    return np.asarray(~grow(~opened, _BORDER))


def _away_from_others(
    search: _Search, name: str, found: dict[str, tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    # A pixel near the intersection of two planes may belong to either.
    inverse, mask = found[name]
    own = search.rays @ inverse
    for other, (theirs, _) in found.items():
        if other != name:
            with np.errstate(divide='ignore', invalid='ignore'):
                gap = np.abs(1 / (search.rays @ theirs) - 1 / own)
            mask = mask & ~(gap < search.tolerance)
    return mask

"""Find planes in a depth image, robustly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from flexx2_sim_ros.truth.clean import HIDDEN, KNOWN, OUTSIDE, REFUSED
from flexx2_sim_ros.truth.observation import grow, Observation
from flexx2_sim_ros.truth.plane_file import PlaneHint
from flexx2_sim_ros.truth.solver import damped_step, robust_weights, TRUNCATION
from matplotlib.path import Path
import numpy as np
from scipy import ndimage

# A pixel is near enough to a plane to be fitted within so many metres and standard deviations of
# depth. Multipath and wiggling bend planes by some centimetres.
_TOLERANCE, _NOISE = 0.02, 3.0
_CAUCHY = 2.0  # standard deviations: a plane with a dark card on it bends more than a mesh
_LEAST = 0.015  # least fraction of the image that a plane covers
# Random triples, of pixels at most so far apart, judged on so many pixels.
_TRIES, _NEAR, _SAMPLE = 400, 24, 4000
_STEPS = 6
_HOLE = 25  # pixels: smaller holes are noise, larger ones may be objects
_DIVIDED = 0.9  # difference of shares of pixels, for two planes to lie on two sides of a line
_REGULAR = 1e-12
_ROUNDS = 2  # a plane is fitted to its region, which depends on the plane
_WINDOW = 9  # pixels: the slope of a surface is that in such a window
_HALFWAY = np.sqrt(0.5)  # cosine: halfway between two surfaces that meet at a right angle
_BORDER = 2  # pixels
_FEW = 0.01  # of a plane's pixels may contradict it, or be hidden, without a note
_PATCH = 4  # pixels around a seed


@dataclass(frozen=True)
class ImagePlane:
    """A plane in an image."""

    name: str
    inverse: np.ndarray  # (3,): inverse depth is the product with the ray (x/z, y/z, 1)
    part: np.ndarray  # (H, W) uint8: which of its pixels are known, one of `clean.PARTS`
    bend: float = 0.0  # metres, rms distance of what the recording shows of it from the plane
    contradicting: int = 0  # pixels of it that noise and bent light do not explain
    beside: int = 0  # pixels between its own, in a row or column, that are of no plane

    @property
    def mask(self) -> np.ndarray:
        """Return (H, W) bool: the known pixels, away from its borders."""
        return np.asarray(self.part == KNOWN)

    @property
    def normal(self) -> np.ndarray:
        """Return the unit normal that points away from the camera, optical frame."""
        return np.asarray(self.inverse / np.linalg.norm(self.inverse))

    @property
    def distance(self) -> float:
        """Return the perpendicular distance from the optical centre, metres."""
        return float(1 / np.linalg.norm(self.inverse))

    def notes(self) -> list[str]:
        """Return what a person should know of its pixels."""
        counts = {
            f'of it contradict it by more than {_TOLERANCE * 1e3:g} mm and noise, and stay '
            'known': self.contradicting,
            'inside it show something nearer, which hides it; if nothing stands there, give its '
            'outline': int((self.part == HIDDEN).sum()),
            'between its own are of other things, or measured wrong, and are unknown; if they '
            'are of it, give its outline': self.beside,
        }
        few = _FEW * self.mask.sum()
        return [f'{self.name}: {n} pixels {words}' for words, n in counts.items() if n > few]


def find_planes(image: Observation, hints: Sequence[PlaneHint]) -> list[ImagePlane]:
    """
    Find planes: those with a box or an outline first, then the largest of the rest.

    The region of a plane is its outline, or the surface around the box, as far as no depth jump
    and no other surface ends it. Those that are found are in the order of the hints.
    """
    search = _Search(image)
    free = image.smooth.copy()
    cores: dict[str, _Core] = {}
    for hint in sorted(hints, key=lambda hint: not (hint.box or hint.outline)):
        told = _told(hint, free.shape)
        start = free if told is None else free & told
        inverse = search.plane(start, free, growing=bool(hint.box))
        if inverse is None:
            continue
        core = _most(_closed(free & search.near(inverse)), start)
        if core.sum() >= _LEAST * core.size or hint.outline:
            cores[hint.name] = _Core(inverse, core, told if hint.outline else None)
            free &= ~core
    for _ in range(_ROUNDS):
        regions = {name: search.region(name, cores) for name in cores}
        for name, region in regions.items():
            fitted = search.fitted(cores[name].inverse, region & image.smooth)
            if fitted is not None:
                cores[name] = replace(cores[name], inverse=fitted)
    found = [search.surface(hint.name, cores, regions) for hint in hints if hint.name in cores]
    return [surface for surface in found if surface.mask.any()]


def surface_around(image: Observation, inverse: np.ndarray, core: np.ndarray) -> np.ndarray:
    """Return the (H, W) bool surface that is seen around pixels that are certainly of a plane."""
    return _Search(image).region('', {'': _Core(inverse, core, None)})


@dataclass(frozen=True)
class _Core:
    # A plane, pixels that are certainly of it, and its outline if that was given.
    inverse: np.ndarray
    mask: np.ndarray
    outline: np.ndarray | None


class _Search:
    # Planes among the pixels of an image.
    def __init__(self, image: Observation) -> None:
        self.image = image
        self.tolerance = _TOLERANCE + _NOISE * image.sigma

    def near(self, inverse: np.ndarray) -> np.ndarray:
        # (H, W) bool: pixels near the plane.
        with np.errstate(divide='ignore', invalid='ignore'):
            clean = 1 / (self.image.directions @ inverse)
            return np.asarray(np.abs(self.image.depth - clean) < self.tolerance)

    @cached_property
    def normals(self) -> np.ndarray:
        # (H, W, 3) of what is seen around each pixel.
        seen = self.image.smooth
        rays = np.where(seen[..., None], self.image.directions, 0)
        inverse = np.where(seen, 1 / np.where(seen, self.image.depth, 1), 0)
        design = rays[..., :, None] * rays[..., None, :]
        sums = ndimage.uniform_filter(design, (_WINDOW, _WINDOW, 1, 1), mode='constant')
        sides = ndimage.uniform_filter(
            rays * inverse[..., None], (_WINDOW, _WINDOW, 1), mode='constant'
        )
        planes = np.linalg.solve(sums + _REGULAR * np.eye(3), sides[..., None])[..., 0]
        return planes / np.maximum(np.linalg.norm(planes, axis=-1, keepdims=True), _REGULAR)

    def region(self, name: str, cores: Mapping[str, _Core]) -> np.ndarray:
        # (H, W) bool: the pixels of a plane, by outline or by the surface around it.
        own = cores[name]
        along = self.image.directions @ own.inverse
        reach = along > 0
        if own.outline is not None:
            return reach & own.outline
        for other, theirs in cores.items():
            if other != name:
                reach &= ~theirs.mask
                behind = self.image.directions @ theirs.inverse > along
                shares = [behind[one.mask].mean() for one in (own, theirs)]
                # Their line of intersection divides two planes that meet.
                if abs(shares[0] - shares[1]) > _DIVIDED:
                    reach &= behind == (shares[0] > shares[1])
        return self._around(own, reach)

    def _around(self, own: _Core, reach: np.ndarray) -> np.ndarray:
        # As far as no depth jump and no other surface ends it.
        like = self.normals @ own.inverse > _HALFWAY * np.linalg.norm(own.inverse)
        return _most(_closed(reach & self.image.smooth & like), own.mask)

    def surface(
        self, name: str, cores: Mapping[str, _Core], regions: Mapping[str, np.ndarray]
    ) -> ImagePlane:
        # What a plane encloses is of it, or is hidden by what is nearer.
        own, region = cores[name], regions[name]
        others = np.zeros_like(region)
        for other, theirs in regions.items():
            if other != name:
                others |= theirs | self._meet(own.inverse, cores[other].inverse)
        depth, along = self.image.depth, self.image.directions @ own.inverse
        with np.errstate(divide='ignore', invalid='ignore'):
            error = depth - 1 / along
            far = np.abs(error) > self.tolerance
        whole, hidden = region.copy(), np.zeros_like(region)
        if own.outline is None:
            holes, count = ndimage.label(ndimage.binary_fill_holes(region) & ~region)
            for k in range(1, count + 1):
                hole = holes == k
                # Nothing is seen through a wall: what is farther is an error, or no return.
                if np.mean(error[hole] < 0) > 0.5:
                    hidden |= hole
                elif not (hole & others).any():
                    whole |= hole
        known = ~grow(~whole, _BORDER) & ~others & np.isfinite(self.image.rays[..., 0])
        part = np.where(whole & ~known, np.uint8(REFUSED), np.uint8(OUTSIDE))
        part[known], part[hidden] = KNOWN, HIDDEN
        shown = self._around(own, region) & self.image.smooth
        apart = (error * along / np.linalg.norm(own.inverse))[shown]
        noise = np.mean(self.image.sigma[shown] ** 2) if shown.any() else 0.0
        bend = float(np.sqrt(max(np.mean(apart**2) - noise, 0.0))) if shown.any() else 0.0
        beside = (_between(region, 0) | _between(region, 1)) & ~whole & ~hidden & ~others & far
        counts = [int(np.count_nonzero(one)) for one in (known & far, beside)]
        return ImagePlane(name, own.inverse, part, bend, *counts)

    def _meet(self, own: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        # A pixel near the intersection of two planes may belong to either.
        with np.errstate(divide='ignore', invalid='ignore'):
            gap = np.abs(1 / (self.image.directions @ theirs) - 1 / (self.image.directions @ own))
        return np.asarray(gap < self.tolerance)

    def plane(self, start: np.ndarray, free: np.ndarray, growing: bool) -> np.ndarray | None:
        # The plane with most pixels of ``start``, grown and fitted to its pixels.
        places = np.argwhere(start)
        if len(places) < 3:
            return None
        inverse = self._best(places)
        if inverse is None:
            return None
        reach = start
        for _ in range(_STEPS):
            reach = free & grow(reach, 8) if growing else free
            inverse = self.fitted(inverse, reach & self.near(inverse))
            if inverse is None:
                return None
        return self.fitted(inverse, free & self.near(inverse))

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
        rays = self.image.directions[triples[..., 0], triples[..., 1]]
        good = np.abs(np.linalg.det(rays)) > 1e-6
        if not good.any():
            return None
        depth = self.image.depth[triples[..., 0], triples[..., 1]]
        planes = np.linalg.solve(rays[good], 1 / depth[good][..., None])[..., 0]
        some = tuple(places[rng.permutation(len(places))[:_SAMPLE]].T)
        along = planes @ self.image.directions[some].T
        with np.errstate(divide='ignore'):
            near = np.abs(1 / along - self.image.depth[some]) < self.tolerance[some]
        return np.asarray(planes[near.sum(axis=1).argmax()])

    def fitted(self, inverse: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
        # Gauss-Newton steps in depth with Cauchy weights.
        rays, depth = self.image.directions[mask], self.image.depth[mask]
        if len(rays) < 3:
            return None
        for _ in range(3):
            clean = 1 / np.maximum(rays @ inverse, 1e-3)
            weight = robust_weights(depth - clean, 0.0, TRUNCATION, _CAUCHY)
            inverse = inverse + damped_step(-rays * clean[:, None] ** 2, weight, depth - clean, 0)
        return inverse


def _between(mask: np.ndarray, axis: int) -> np.ndarray:
    # Pixels with some of the mask on both sides.
    back = np.logical_or.accumulate(np.flip(mask, axis), axis=axis)
    return np.asarray(np.logical_or.accumulate(mask, axis=axis) & np.flip(back, axis))


def _told(hint: PlaneHint, shape: tuple[int, ...]) -> np.ndarray | None:
    # Pixels that the file says are of the plane; None where it says nothing.
    v, u = np.mgrid[: shape[0], : shape[1]]
    if hint.outline:
        inside = Path(hint.outline).contains_points(np.column_stack([u.ravel(), v.ravel()]))
        return np.asarray(inside.reshape(shape))
    if not hint.box:
        return None
    (left, top), (right, bottom) = np.array(hint.box).reshape(2, 2) + [[-_PATCH], [_PATCH]]
    return np.asarray((u >= left) & (u <= right) & (v >= top) & (v <= bottom))


def _most(mask: np.ndarray, of: np.ndarray) -> np.ndarray:
    # The connected part of a mask with most pixels of another mask.
    parts, _ = ndimage.label(mask)
    sizes = np.bincount(parts[of], minlength=1)
    sizes[0] = 0
    return np.asarray((parts == sizes.argmax()) & (sizes.max() > 0) & mask)


def _closed(mask: np.ndarray) -> np.ndarray:
    # Closes small holes, which are noise, and cuts bridges of a few pixels.
    holes, count = ndimage.label(~mask)
    small = np.bincount(holes.ravel(), minlength=count + 1) <= _HOLE
    small[0] = False
    square = np.ones((3, 3), bool)
    return np.asarray(ndimage.binary_opening(mask | small[holes], square, iterations=_BORDER))

"""Clean depth for a camera at a pose, and how accurately it is known."""

from dataclasses import dataclass, replace

from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.truth.alignment import unwrapped
from flexx2_sim_ros.truth.observation import grow, Observation
from flexx2_sim_ros.truth.rooms import Room
import numpy as np

# What is known of a pixel. Outside: it is not of the surfaces that are known. Hidden: something
# stands before them, or the recording's own mask says so. Refused: it is where surfaces end or
# meet, or the pose of its frame is not known.
PARTS = 'outside', 'known', 'hidden', 'refused'
OUTSIDE, KNOWN, HIDDEN, REFUSED = range(4)
_BORDER = 2  # pixels around a hole that may belong to it
_STEEPEST = 0.05  # of the product of normal and ray: a surface along the ray is of no use
_STEP = 0.03  # fraction of depth: a jump between neighbouring pixels
# At least 5 x 5 pixels that differ by this much, and wraps do not explain it, are another thing if
# they are nearer. Nothing is seen through a surface: what is farther is an error.
_STRANGE, _STRANGE_NOISE, _PATCH = 0.15, 6.0, 2


@dataclass(frozen=True)
class Clean:
    """Ground truth of one image, each (H, W), float32; NaN where there is no return."""

    depth: np.ndarray  # metres along the optical axis
    incidence: np.ndarray  # radians between ray and surface normal
    reflectivity: np.ndarray | None  # 0 to 1
    part: np.ndarray  # uint8, one of `PARTS` by its number
    sigma: np.ndarray  # metres: standard deviation of the surface along the optical axis
    # Standard deviation of the logarithm of the reflectivity over a surface.
    reflectivity_spread: np.ndarray | None = None

    @property
    def known(self) -> np.ndarray:
        """Return (H, W) bool: the pixels that are known."""
        return np.asarray(self.part == KNOWN)

    def without(self, pixels: np.ndarray | bool, why: int) -> 'Clean':
        """Return it with known pixels of an (H, W) bool array unknown, for one of `PARTS`."""
        return replace(self, part=np.where(self.known & pixels, np.uint8(why), self.part))


def render(room: Room, pose: Pose, rays: np.ndarray, room_error: float) -> Clean:
    """Render clean depth along (H, W, 2) rays; surfaces are accurate to `room_error`, metres."""
    shape = rays.shape[:2]
    flat = np.nan_to_num(rays.reshape(-1, 2))
    hits = room.cast(pose, flat)
    depth = hits.depth.reshape(shape)
    slant = -hits.slant(flat)
    with np.errstate(invalid='ignore', divide='ignore'):
        cosine = slant / np.sqrt(1 + (flat**2).sum(axis=1))
        sigma = room_error / np.maximum(slant, _STEEPEST)
    blind = ~np.isfinite(rays[..., 0])
    depth[blind] = np.nan
    nothing = ~np.isfinite(depth)
    part = np.full(shape, KNOWN, np.uint8)
    part[blind] = OUTSIDE
    if not room.complete:
        border = grow(hits.border.reshape(shape), _BORDER) & grow(_steps(depth), _BORDER)
        part[border | grow(nothing, _BORDER)] = REFUSED
        part[nothing] = OUTSIDE
    incidence = np.arccos(np.clip(cosine, 0, 1)).reshape(shape)
    return Clean(
        depth.astype(np.float32),
        np.where(nothing, np.nan, incidence).astype(np.float32),
        None if hits.reflectivity is None else hits.reflectivity.reshape(shape).astype(np.float32),
        part,
        np.where(nothing.ravel(), room_error, sigma).reshape(shape).astype(np.float32),
    )


def unknown(image: Observation) -> Clean:
    """Return ground truth of an image in which nothing is known."""
    nothing = np.full(image.depth.shape, np.nan, np.float32)
    part = np.full(nothing.shape, OUTSIDE, np.uint8)
    return Clean(nothing, nothing.copy(), None, part, np.zeros_like(nothing))


def render_plane(
    image: Observation, inverse: np.ndarray, plane_error: float, where: np.ndarray | bool = True
) -> Clean:
    """Render an `ImagePlane`, accurate to `plane_error` metres; all but `where` is outside."""
    along = image.directions @ (inverse / np.linalg.norm(inverse))
    with np.errstate(invalid='ignore', divide='ignore'):
        seen = (along > 0) & where
        depth = np.where(seen, 1 / np.linalg.norm(inverse) / along, np.nan)
        incidence = np.where(seen, np.arccos(np.clip(along / image.length, 0, 1)), np.nan)
        sigma = plane_error / np.maximum(along, _STEEPEST)
    part = np.where(seen, np.uint8(KNOWN), np.uint8(OUTSIDE))
    sigma = np.where(seen, sigma, plane_error).astype(np.float32)
    return Clean(depth.astype(np.float32), incidence.astype(np.float32), None, part, sigma)


def _steps(depth: np.ndarray) -> np.ndarray:
    out = np.zeros(depth.shape, bool)
    with np.errstate(invalid='ignore'):
        out[1:] |= np.abs(np.diff(depth, axis=0)) > _STEP * depth[1:]
        out[:, 1:] |= np.abs(np.diff(depth, axis=1)) > _STEP * depth[:, 1:]
    return out


def edges(clean: Clean) -> np.ndarray:
    """Return (H, W) bool: pixels where clean depth jumps or ends."""
    out, ends = _steps(clean.depth), np.isfinite(clean.depth)
    out[1:] |= ends[1:] != ends[:-1]
    out[:, 1:] |= ends[:, 1:] != ends[:, :-1]
    return out


def difference(clean: Clean, image: Observation) -> np.ndarray:
    """Return (H, W) measured minus clean depth, metres, without whole wraps."""
    raw = (image.depth - clean.depth).ravel()
    return unwrapped(raw, image.length.ravel(), image.wraps).reshape(clean.depth.shape)


def apart(clean: Clean, image: Observation) -> np.ndarray:
    """Return (H, W) int: -1 in patches that are nearer than the ground truth, 1 if farther."""
    error = np.where(clean.known, difference(clean, image), 0.0)
    out = np.zeros(error.shape, np.int8)
    for sign in (-1, 1):
        with np.errstate(invalid='ignore'):
            far = sign * error > _STRANGE + _STRANGE_NOISE * image.sigma
        out[grow(~grow(~far, _PATCH), _PATCH) & far] = sign
    return out


def without_hidden(clean: Clean, image: Observation) -> Clean:
    """Return ground truth that is unknown where something stands before it."""
    return clean.without(apart(clean, image) < 0, HIDDEN)

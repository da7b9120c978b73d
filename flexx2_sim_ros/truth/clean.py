"""Clean depth for a camera at a pose, and how accurately it is known."""

from dataclasses import dataclass

from flexx2_sim_ros.truth.alignment import unwrapped
from flexx2_sim_ros.truth.observation import grow, Observation
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.rooms import Room
import numpy as np

_BORDER = 2  # pixels around a hole that may belong to it
_STEP = 0.03  # fraction of depth: a jump between neighbouring pixels
# If at least 5 x 5 pixels differ by this much, and wraps do not explain it, an object was moved or
# is missing in the mesh.
_STRANGE, _STRANGE_NOISE, _PATCH = 0.15, 6.0, 2


@dataclass(frozen=True)
class Clean:
    """
    Ground truth of one image.

    Attributes
    ----------
    depth : numpy.ndarray
        (H, W) float32 metres along the optical axis, NaN where there is no return.
    incidence : numpy.ndarray
        (H, W) float32 radians between ray and surface normal, NaN where there is no return.
    reflectivity : numpy.ndarray or None
        (H, W) float32, 0 to 1.
    known : numpy.ndarray
        (H, W) bool.
    sigma : numpy.ndarray
        (H, W) float32 metres: standard deviation of the room's surface along the optical axis.
    reflectivity_spread : numpy.ndarray or None
        (H, W) float32, standard deviation of the logarithm of `reflectivity` over a surface.

    """

    depth: np.ndarray
    incidence: np.ndarray
    reflectivity: np.ndarray | None
    known: np.ndarray
    sigma: np.ndarray
    reflectivity_spread: np.ndarray | None = None


def render(room: Room, pose: Pose, rays: np.ndarray, room_error: float) -> Clean:
    """
    Render clean depth.

    Parameters
    ----------
    room : Room
        The room in view.
    pose : Pose
        The camera's.
    rays : numpy.ndarray
        (H, W, 2) x/z and y/z; NaN where a pixel has no ray.
    room_error : float
        Standard deviation of the room's surfaces along their normals, metres.

    Returns
    -------
    Clean

    """
    shape = rays.shape[:2]
    flat = np.nan_to_num(rays.reshape(-1, 2))
    hits = room.cast(pose, flat)
    depth = hits.depth.reshape(shape)
    slant = -hits.slant(flat)
    with np.errstate(invalid='ignore', divide='ignore'):
        cosine = slant / np.sqrt(1 + (flat**2).sum(axis=1))
        sigma = room_error / np.maximum(slant, 0.05)
    blind = ~np.isfinite(rays[..., 0])
    depth[blind] = np.nan
    nothing = ~np.isfinite(depth)
    if room.complete:
        known = ~blind
    else:
        near = grow(nothing, _BORDER)
        border = grow(hits.border.reshape(shape), _BORDER) & grow(_steps(depth), _BORDER)
        known = ~(near | border)
    incidence = np.arccos(np.clip(cosine, 0, 1)).reshape(shape)
    return Clean(
        depth.astype(np.float32),
        np.where(nothing, np.nan, incidence).astype(np.float32),
        None if hits.reflectivity is None else hits.reflectivity.reshape(shape).astype(np.float32),
        known,
        np.where(nothing.ravel(), room_error, sigma).reshape(shape).astype(np.float32),
    )


def _steps(depth: np.ndarray) -> np.ndarray:
    out = np.zeros(depth.shape, bool)
    with np.errstate(invalid='ignore'):
        out[1:] |= np.abs(np.diff(depth, axis=0)) > _STEP * depth[1:]
        out[:, 1:] |= np.abs(np.diff(depth, axis=1)) > _STEP * depth[:, 1:]
    return out


def edges(clean: Clean) -> np.ndarray:
    """Return (H, W) bool: pixels where clean depth jumps or ends."""
    ends = np.isfinite(clean.depth)
    out = _steps(clean.depth)
    out[1:] |= ends[1:] != ends[:-1]
    out[:, 1:] |= ends[:, 1:] != ends[:, :-1]
    return out


def difference(clean: Clean, image: Observation) -> np.ndarray:
    """Return (H, W) measured minus clean depth, metres, without whole wraps."""
    raw = (image.depth - clean.depth).ravel()
    return unwrapped(raw, image.length.ravel(), image.wraps).reshape(clean.depth.shape)


def strange(clean: Clean, image: Observation) -> np.ndarray:
    """Return (H, W) bool: whole patches whose depth contradicts the room."""
    with np.errstate(invalid='ignore'):
        far = np.abs(difference(clean, image)) > _STRANGE + _STRANGE_NOISE * image.sigma
    core = ~grow(~far, _PATCH)
    return grow(core, _PATCH) & far

"""Find a camera's pose in a room, from a rough guess or from none."""

from dataclasses import replace
from functools import lru_cache
import math
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.truth.alignment import align, AlignedPose, choose
from flexx2_sim_ros.truth.observation import Observation
from flexx2_sim_ros.truth.rooms import load_room
import numpy as np
from scipy.spatial.transform import Rotation

UPS = {
    sign + axis: (1 if sign == '+' else -1) * np.eye(3)[i]
    for sign in '+-'
    for i, axis in enumerate('xyz')
}
_CELLS = 9, 12  # rows and columns of the thumbnail that is compared
_PLACES = 500  # at most
_SPACING = 0.4  # metres between places, at least
_SKY = 30, 60  # elevation and azimuth of a panorama
_NEAREST = 0.1  # least distance of a camera from a surface, metres
_YAWS, _PITCHES, _ROLLS = 24, np.radians(np.arange(-75, 76, 15)), np.radians([-20, 0, 20])
_TRUNCATION = 0.5  # metres
_KEPT = 200  # candidates that are aligned
# Rounds of alignment: pixels, steps, reach in metres, poses that go on to the next round.
_ROUNDS = (120, 4, 0.5, 50), (400, 8, 0.3, 8), (4000, 15, 0.1, 3)
# Around a rough pose: shifts (metres) and turns (radians).
_SHIFT, _TURN = 0.15, math.radians(10)
_AS_GOOD = 1.03  # times the least cost
_FAR = 0.5, math.radians(30)  # from a rough pose, that it cannot have meant
# Poses closer than this count as equal.
_SAME_PLACE, _SAME_TURN = 0.03, math.radians(1.5)
# Poses farther apart than this contradict each other; poses between the limits have not converged.
_ELSEWHERE = 0.2, math.radians(10)


@lru_cache(maxsize=1)
def look_around(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a grid of places in the free space of a room, and what is seen from them.

    The places are (P, 3), metres; distances to surfaces (P, N) float32, metres, inf without a hit,
    in the directions of `_SKY`, row by row. The path is that of `load_room`.
    """
    room = load_room(path)
    low, high = room.bounds
    size = np.maximum(high - low, 1e-3)
    spacing = max(_SPACING, float((np.prod(np.maximum(size, _SPACING)) / _PLACES) ** (1 / 3)))
    counts = np.maximum(size / spacing, 1).astype(int).tolist()
    axes = [a + (np.arange(n) + 0.5) * s / n for a, s, n in zip(low, size, counts, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    rows, columns = _SKY
    elevation = (np.arange(rows) + 0.5) / rows * np.pi - np.pi / 2
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi - np.pi
    e, a = np.meshgrid(elevation, azimuth, indexing='ij')
    sky = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)
    seen = np.array([room.hit(place, sky).depth for place in places], np.float32)
    distance = np.nan_to_num(seen, nan=np.inf)
    with np.errstate(invalid='ignore'):  # Where hardly a ray hits anything.
        free = np.percentile(distance, 5, axis=1) > _NEAREST
    return places[free], distance[free]


def find(room: Path, observation: Observation, guess: Pose | None, up: str = '+z') -> AlignedPose:
    """
    Find the pose of a depth image, within about 0.3 m and 20 degrees of a guess.

    Without a guess, it is searched in the whole room, whose direction `up` is one of `UPS`.
    Raises `InputError` where the room then has no free place: a single wall.
    """
    if guess is not None:
        # The guess itself, then shifted and turned along each axis.
        around = np.diag(np.repeat([_SHIFT, _TURN], 3))
        signed = [sign * motion for motion in around for sign in (-1, 1)]
        starts = [guess.moved(motion) for motion in (np.zeros(6), *signed)]
    else:
        starts = _candidates(observation, *look_around(room), up)
        if not starts:
            raise InputError(
                'the room: must have free places within its bounds, as a single wall has not; '
                'give a rough pose (--pose or --trajectory)'
            )
    fits = [AlignedPose(start, 0.0) for start in starts]
    for pixels, steps, reach, kept in _ROUNDS:
        target = choose(observation, pixels)
        fits = [align(room, target, one.pose, steps, reach) for one in fits]
        if guess is not None:
            fits = [fit for fit in fits if not _differ(fit.pose, guess, *_FAR)] or fits[:1]
        fits = _distinct(sorted(fits, key=lambda fit: fit.cost), kept)
    if guess is not None:
        # If the image does not determine the pose, the guess does.
        limit = _AS_GOOD * fits[0].cost
        fits.sort(key=lambda fit: (fit.cost > limit, _distance(fit.pose, guess)))
    rivals = [one.cost for one in fits[1:] if _differ(one.pose, fits[0].pose, *_ELSEWHERE)]
    return replace(fits[0], rival=min(rivals, default=math.inf))


def _distance(one: Pose, other: Pose) -> float:
    motion = one.motion_to(other)
    return float(np.linalg.norm(motion[:3]) / _SHIFT + np.linalg.norm(motion[3:]) / _TURN)


def _distinct(fits: list[AlignedPose], most: int) -> list[AlignedPose]:
    # The first poses that differ from each other.
    out: list[AlignedPose] = []
    for fit in fits:
        if len(out) < most and all(_differ(fit.pose, other.pose) for other in out):
            out.append(fit)
    return out


def _differ(one: Pose, other: Pose, place: float = _SAME_PLACE, turn: float = _SAME_TURN) -> bool:
    if np.linalg.norm(one.R.T @ (other.t - one.t)) > place:
        return True  # Most poses do; to compare the turns takes ten times as long.
    return bool(np.linalg.norm(one.motion_to(other)[3:]) > turn)


def _candidates(
    observation: Observation, places: np.ndarray, distance: np.ndarray, up: str
) -> list[Pose]:
    rays, ranges = _thumbnail(observation)
    turns = _orientations(UPS[up])
    scores = _scores(distance, turns, rays, ranges)
    # The best orientations of each place first, so that one place does not take all.
    order = np.argsort(scores, axis=None)[: 20 * _KEPT]
    kept: list[Pose] = []
    for index in order:
        place, turn = divmod(int(index), len(turns))
        pose = Pose(turns[turn].astype(float), places[place])
        if all(
            np.linalg.norm(one.t - pose.t) > _SPACING * 1.5
            or np.trace(one.R.T @ pose.R) < 1 + 2 * math.cos(math.radians(25))
            for one in kept
        ):
            kept.append(pose)
        if len(kept) == _KEPT:
            break
    return kept


def _thumbnail(observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    # (N, 3) unit rays and (N,) median ranges of the cells of the image.
    height, width = observation.depth.shape
    rays, ranges = [], []
    reach = observation.depth * observation.length
    for row in np.array_split(np.arange(height), min(_CELLS[0], height)):
        for column in np.array_split(np.arange(width), min(_CELLS[1], width)):
            cell = np.ix_(row, column)
            good = np.isfinite(reach[cell]) & np.isfinite(observation.rays[cell][..., 0])
            if good.mean() > 0.3:
                x, y = observation.rays[cell][good].mean(axis=0)
                ray = np.array([x, y, 1.0])
                rays.append(ray / np.linalg.norm(ray))
                ranges.append(np.median(reach[cell][good]))
    return np.array(rays, np.float32).reshape(-1, 3), np.array(ranges, np.float32)


def _orientations(up: np.ndarray) -> np.ndarray:
    # (N, 3, 3) float32: all yaw angles, with pitch and roll of an upright camera.
    across = np.eye(3)[np.argmin(np.abs(up))]
    ahead = np.cross(up, across)
    base = np.stack([np.cross(ahead, up), -up, ahead], axis=1)  # right, down, forward
    turns = [
        base @ Rotation.from_euler('YXZ', [yaw, pitch, roll]).as_matrix()
        for yaw in np.arange(_YAWS) * 2 * np.pi / _YAWS
        for pitch in _PITCHES
        for roll in _ROLLS
    ]
    return np.array(turns, np.float32)


def _scores(
    distance: np.ndarray, turns: np.ndarray, rays: np.ndarray, ranges: np.ndarray
) -> np.ndarray:
    # (places, turns) sums of truncated differences of ranges.
    rows, columns = _SKY
    x, y, z = np.moveaxis(np.einsum('tij,nj->tni', turns, rays), -1, 0)
    row = ((np.arcsin(np.clip(z, -1, 1)) / np.pi + 0.5) * rows).astype(int)
    column = ((np.arctan2(y, x) / (2 * np.pi) + 0.5) * columns).astype(int)
    cells = np.minimum(row, rows - 1) * columns + np.minimum(column, columns - 1)
    off = (np.abs(distance[:, cell] - ranges) for cell in cells)
    return np.stack([np.minimum(one, _TRUNCATION).sum(axis=1) for one in off], axis=1)

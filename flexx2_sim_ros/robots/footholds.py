"""Find footholds, the height of a foot's way to them, and obstacles."""

import math

from flexx2_sim_ros.rendering.rays import Ground
import numpy as np

# The ground is even if it deviates from a plane by less than this, metres.
EVEN = 0.006
# Largest height of a foothold or an obstacle above or below the mean of the feet, metres.
REACH = 0.2

_TURN = np.arange(8) * np.pi / 4
_RING = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
# Displacements to try for an even foothold, the nearest first, metres.
ASIDE = np.array(
    sorted(
        (
            (x, y)
            for x in (-0.12, -0.09, -0.06, -0.03, 0.0, 0.03, 0.06, 0.09, 0.12)
            for y in (-0.06, -0.03, 0.0, 0.03, 0.06)
        ),
        key=lambda p: math.hypot(*p),
    )
)
# One metre of roughness costs as much as this many metres of displacement.
ROUGHNESS_COST = 10.0
# Places where the way is checked, metres from the trunk's centre: a stride and braking distance.
_AHEAD = np.linspace(0.2, 0.48, 6)
_SIDES = np.array([-0.12, 0.0, 0.12])
# A height difference above this between two of these places stops the robot, metres.
_LARGEST_EDGE = 0.14


def rest_height(
    place: np.ndarray, top: float, ground: Ground, radius: float
) -> tuple[float, float]:
    """
    Return the height and the roughness of a foothold at `place` (2,) in the world, metres.

    The height is that of the middle of a foot of `radius` when it touches the highest point below
    it; NaN without ground. The roughness is by how much the ground around it differs from a plane.
    ``top`` is where to look for the ground from.
    """
    inner, outer = 0.7 * radius, 1.8 * radius
    points = np.concatenate(
        [place[None], place + inner * _RING, place + radius * _RING, place + outer * _RING]
    )
    heights = ground.heights(points, top)
    lifts = np.repeat([radius, math.sqrt(radius**2 - inner**2), 0.0, -np.inf], [1, 8, 8, 8])
    edge = heights[-8:]
    # On an even slope, the heights of the ring are a constant plus a first harmonic.
    plane = edge.mean() + _RING @ (_RING.T @ edge / 4)
    return float((heights + lifts).max()), float(np.abs(edge - plane).max())


def way_height(
    foot: np.ndarray, place: np.ndarray, top: float, ground: Ground, radius: float
) -> float:
    """Return the height that a foot's centre needs between two places (3,); inf if blocked."""
    way = np.append(place[:2] - foot[:2], 0.0)
    length = math.hypot(*way)
    # Rays from above miss a shape that they start in; level rays hit it.
    rays = [(np.append(place[:2], top), np.append(side, 0.0), 2 * radius) for side in _RING]
    if length > 1e-6:
        rays.append((np.append(foot[:2], top), way / length, length))
    if any(ground.free(origin, direction) < least for origin, direction, least in rays):
        return math.inf
    points = np.linspace(foot[:2], place[:2], 9)[:, None]
    passed = ground.heights(np.concatenate([points, points + radius * _RING], axis=1), top)
    highest = float(passed.max()) + radius
    return math.inf if math.isnan(highest) else max(highest, float(foot[2]), float(place[2]))


def find_foothold(
    foot: np.ndarray,
    place: np.ndarray,
    turn: np.ndarray,
    level: float,
    top: float,
    ground: Ground,
    radius: float,
) -> tuple[np.ndarray, float] | None:
    """
    Find an even place near the wanted one; None when no place is within reach.

    Returned are the place of the foot's centre (3,) and the height that it needs on the way,
    metres. ``foot`` (3,) is the foot's middle now, ``place`` (2,) where it is wanted, ``turn`` (2,
    2) the robot's heading there, as a rotation, all in the world. ``level`` is the mean height of
    the feet's middles, ``top`` where to look for the ground from, ``radius`` that of the foot.
    """
    best, best_cost = None, math.inf
    for aside in ASIDE:
        point = place + turn @ aside
        height, rough = rest_height(point, top, ground, radius)
        cost = math.hypot(*aside) + ROUGHNESS_COST * rough
        if not (abs(height - level) < REACH and cost < best_cost):
            continue
        candidate = np.append(point, height)
        highest = way_height(foot, candidate, top, ground, radius)
        if highest - level < REACH:
            best, best_cost = (candidate, highest), cost
            if rough < EVEN:
                break
    return best


def blocked(
    position: np.ndarray, rotation: np.ndarray, course: np.ndarray, height: float, ground: Ground
) -> bool:
    """
    Return whether an obstacle or an edge is in the robot's way.

    ``position`` (3,) and ``rotation`` (3, 3) are of the trunk in the world; ``course`` (2,), not
    zero, is where it is going, in its own frame; ``height`` is that of the trunk above the ground
    it stands on, metres.
    """
    ahead = rotation @ np.append(course / math.hypot(*course), 0.0)
    across = rotation @ np.append(np.array([-course[1], course[0]]) / math.hypot(*course), 0.0)
    starts = position + _SIDES[:, None] * across
    if any(ground.free(start, ahead) < _AHEAD[-1] for start in starts):
        return True
    places = starts[:, None] + _AHEAD[:, None] * ahead
    found = ground.heights(places[..., :2], float(places[..., 2].max()))
    # Nearer ground was checked before: it is taken as parallel to the trunk.
    spacing = (_AHEAD[1] - _AHEAD[0]) * ahead[2]
    known = places[:, :1, 2] - height - spacing * np.array([2.0, 1.0])
    heights = np.concatenate([known, found], axis=1)
    return not bool((np.abs(heights[:, 2:] - heights[:, :-2]) < _LARGEST_EDGE).all())

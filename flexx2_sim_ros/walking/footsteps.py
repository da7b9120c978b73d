"""Choose footholds on a grid of heights, for many walks at once, and judge them."""

from dataclasses import dataclass

from flexx2_sim_ros.robots.footholds import ASIDE, REACH, ROUGHNESS_COST
from flexx2_sim_ros.robots.kinematics import LegGeometry
from flexx2_sim_ros.robots.trot import apex_height, Gait, OFFSET
from flexx2_sim_ros.walking.terrain import Terrain
import numpy as np

# Why a walk ends, in the order in which the reasons are looked for.
REASONS = 'no foothold', 'stumbles', 'wrong height', 'slips'
# Friction of a foot on the ground: that of `config/models/go1.xml`, as in MuJoCo Menagerie.
_FRICTION = 0.8
# A foot has missed the ground if it meets it higher or lower than planned by more than this
# fraction of the gait's clearance (assumed). The gait keeps this fraction over the highest steps.
_MISSED = 0.5
# Points of a foot's sphere that may touch the ground, as fractions of its radius.
_TOUCHING = np.array([0.3, 0.6, 0.8, 1.0])
_TURN = np.arange(8) * np.pi / 4
_RING = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)
_WAY = np.linspace(0.0, 1.0, 9)[:, None]  # places on a foot's way, as fractions of it
_ASIDE = np.abs(ASIDE).max(axis=0) + 1e-6


@dataclass(frozen=True)
class Footstep:
    """
    One step of one foot.

    ``leg`` is 0 to 3: front right, front left, rear right, rear left. ``lift`` and ``land`` are
    seconds since the walk began; ``wanted`` is (2,) where the foot is best put down, metres.
    """

    leg: int
    lift: float
    land: float
    wanted: np.ndarray


@dataclass(frozen=True)
class Grid:
    """
    Heights at the points of a grid, for N walks: (N, X, Y) metres, NaN where unknown.

    ``ahead`` (X,) and ``left`` (Y,) are coordinates, metres, evenly spaced by the same distance.
    """

    ahead: np.ndarray
    left: np.ndarray
    heights: np.ndarray

    def highest(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) metres: the highest known of the cells of (N, P, 2) points, or -inf."""
        pitch = self.ahead[1] - self.ahead[0]
        x = np.rint((points[..., 0] - self.ahead[0]) / pitch).astype(int)
        y = np.rint((points[..., 1] - self.left[0]) / pitch).astype(int)
        inside = (x >= 0) & (x < len(self.ahead)) & (y >= 0) & (y < len(self.left))
        walk = np.arange(len(points))[:, None]
        found = self.heights[walk, np.where(inside, x, 0), np.where(inside, y, 0)]
        return np.asarray(np.where(inside & np.isfinite(found), found, -np.inf).max(axis=1))


@dataclass(frozen=True)
class Feet:
    """
    Where the feet of N robots stand: (N, 4, 2) metres.

    ``heights`` are (N, 4) of the ground under each, metres.
    """

    places: np.ndarray
    heights: np.ndarray


def footsteps(
    speed: float, first: float, last: float, gait: Gait, legs: LegGeometry
) -> list[Footstep]:
    """
    Return the steps of a trot straight ahead, by the time at which the foot leaves the ground.

    ``speed`` is in m/s. Only steps to places between ``first`` and ``last``, metres ahead of the
    start, are returned.
    """
    out = []
    stride = speed * gait.period
    for leg in range(4):
        # A foot is best put down where it is under its hip half-way through its stance.
        reach = legs.neutral[leg, 0] + speed * gait.period * (gait.duty / 2 - OFFSET[leg])
        low, high = np.ceil((first - reach) / stride), np.floor((last - reach) / stride)
        for cycle in np.arange(low, high + 1):
            land = float((cycle - OFFSET[leg]) * gait.period)
            wanted = np.array([reach + cycle * stride, legs.neutral[leg, 1]])
            out.append(Footstep(leg, land - (1 - gait.duty) * gait.period, land, wanted))
    return sorted(out, key=lambda one: one.lift)


@dataclass(frozen=True)
class Planned:
    """
    A step of one foot of N robots, as planned on a grid.

    ``place`` is (N, 2) where the foot is put down, ``height`` (N,) the ground there and ``apex``
    (N,) how high the foot goes above its own size, all in metres; ``found`` (N,) bool says whether
    there is a foothold.
    """

    place: np.ndarray
    height: np.ndarray
    apex: np.ndarray
    found: np.ndarray


def roughness(heights: np.ndarray) -> np.ndarray:
    """
    Return by how much each cell differs from the highest or lowest cell around it, metres.

    Heights and result are (N, X, Y), heights NaN where unknown; an unknown neighbour counts as a
    cell that is out of reach.
    """
    padded = np.pad(heights, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    out = np.zeros_like(heights)
    _, width, length = heights.shape
    for x in range(3):
        for y in range(3):
            apart = np.abs(padded[:, x : x + width, y : y + length] - heights)
            np.maximum(out, np.where(np.isnan(apart), REACH, apart), out=out)
    return out


def plan(
    grid: Grid, rough: np.ndarray, step: Footstep, feet: Feet, gait: Gait, radius: float
) -> Planned:
    """
    Choose a foothold as the gait does: near the wanted place, even and within reach.

    ``grid`` has the heights that are known when the foot, of `radius` metres, leaves the ground;
    ``rough`` is its `roughness`. ``feet`` are where they stand; `gait` has the clearance.
    """
    x = np.flatnonzero(np.abs(grid.ahead - step.wanted[0]) <= _ASIDE[0])
    y = np.flatnonzero(np.abs(grid.left - step.wanted[1]) <= _ASIDE[1])
    cells = np.stack(np.meshgrid(x, y, indexing='ij'), axis=-1).reshape(-1, 2)
    points = np.stack([grid.ahead[cells[:, 0]], grid.left[cells[:, 1]]], axis=-1)
    heights = grid.heights[:, cells[:, 0], cells[:, 1]]
    level = feet.heights.mean(axis=1)
    cost = np.linalg.norm(points - step.wanted, axis=1)
    cost = cost + ROUGHNESS_COST * rough[:, cells[:, 0], cells[:, 1]]
    reached = np.abs(heights - level[:, None]) < REACH  # False where the height is unknown
    cost = np.where(reached, cost, np.inf)
    best = cost.argmin(axis=1)
    walk = np.arange(len(heights))
    place, height = points[best], heights[walk, best]
    way = _way(feet.places[:, step.leg], place, radius)
    highest = np.maximum(grid.highest(way), np.maximum(feet.heights[:, step.leg], height))
    found = np.isfinite(cost[walk, best]) & (highest - level < REACH)
    return Planned(place, height, apex_height(highest, level, gait), found)


def land(
    planned: Planned, step: Footstep, feet: Feet, terrain: Terrain, gait: Gait, radius: float
) -> tuple[Feet, np.ndarray]:
    """
    Put a foot, of `radius` metres, down on the true ground.

    ``feet`` are where they stand before. Returned is where they stand after (a foot without
    foothold stays), and (N,) int: index in `REASONS` of why the walk ends here, -1 where it goes
    on.
    """
    way = _way(feet.places[:, step.leg], planned.place, radius)
    stumbles = terrain.heights(way).max(axis=1) > planned.apex
    height, off = _rest(planned.place, terrain, radius)
    wrong = np.abs(height - planned.height) > _MISSED * gait.lift
    # The ground pushes a sphere towards its middle: along the cone of friction or within it.
    slips = off > np.sin(np.arctan(_FRICTION))
    failures = np.stack([~planned.found, stumbles, wrong, slips])
    reason = np.where(failures.any(axis=0), failures.argmax(axis=0), -1)
    places, heights = feet.places.copy(), feet.heights.copy()
    places[:, step.leg] = np.where(planned.found[:, None], planned.place, places[:, step.leg])
    heights[:, step.leg] = np.where(planned.found, height, heights[:, step.leg])
    return Feet(places, heights), reason


def _way(start: np.ndarray, end: np.ndarray, radius: float) -> np.ndarray:
    # (N, P, 2) points under a foot on its way.
    line = start[:, None] + _WAY * (end - start)[:, None]
    around = line[:, :, None] + radius * np.concatenate([np.zeros((1, 2)), _RING])
    return around.reshape(len(start), -1, 2)


def _rest(place: np.ndarray, terrain: Terrain, radius: float) -> tuple[np.ndarray, np.ndarray]:
    # Height of the ground under a sphere that lies on it, and how far from its middle it touches
    # the ground, as a fraction of the radius.
    off = np.concatenate([[0.0], np.repeat(_TOUCHING, len(_RING))])
    directions = np.concatenate([np.zeros((1, 2)), np.tile(_RING, (len(_TOUCHING), 1))])
    points = place[:, None] + radius * off[:, None] * directions
    lowest = radius * (1 - np.sqrt(1 - off**2))  # of the sphere at these points, above its bottom
    raised = terrain.heights(points) - lowest
    touching = raised.argmax(axis=1)
    return raised[np.arange(len(place)), touching], off[touching]

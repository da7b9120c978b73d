"""Terrain for many walks: stairs, rubble and gaps, each made of blocks with level tops."""

from collections.abc import Callable
from dataclasses import dataclass

from flexx2_sim_ros.rendering.scenes import load_materials
import numpy as np

# The robot starts at x = 0 on level ground and walks along x. The terrain begins at a random place
# in an interval as long as a stride, metres.
FIRST, LAST_FIRST = 0.9, 1.16
_YAW = 0.15  # of stairs and gaps to the robot's way, at most, radians
_RUN = 0.30  # of a stair, metres: the scene `stairs`
_STAIRS = 3
_SLAB = 0.25  # metres between two gaps
_WIDTHS = 0.06, 0.14  # of a gap, metres
_BLOCKS = 8
_RUBBLE = (0.95, 1.95), (-0.35, 0.35)  # where rubble lies, metres
_LOWEST = 0.3  # of the blocks of rubble, as a fraction of the step height
_HALF_HEIGHT = 0.5  # of all blocks: they reach into the ground
_FLOOR = (10.0, 10.0, _HALF_HEIGHT)
# Surfaces, of which each walk and block gets one: `config/materials.yaml` has their reflectivity.
_MATERIALS = 'floor', 'concrete', 'brick', 'wood', 'black'

# Of the blocks after the floor, in one walk: centres (B, 2), yaws (B,), tops (B,).
_Blocks = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Terrain:
    """
    The terrain of N walks, each of B blocks. x is ahead, y left, z up.

    Attributes
    ----------
    half : numpy.ndarray
        (B, 3) half the extent of each block along its own axes, metres; the same in all walks.
        The first block is the floor.
    centre : numpy.ndarray
        (N, B, 2) metres.
    yaw : numpy.ndarray
        (N, B) turn about z, radians.
    top : numpy.ndarray
        (N, B) height of the block's top, metres.
    reflectivity : numpy.ndarray
        (N, B) of the block, 0 to 1.

    """

    half: np.ndarray
    centre: np.ndarray
    yaw: np.ndarray
    top: np.ndarray
    reflectivity: np.ndarray

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Return (N, ...) metres: the ground at (N, ..., 2) points of each walk."""
        count = len(points)
        flat = points.reshape(count, -1, 2)
        out = np.full(flat.shape[:2], -np.inf)
        for block, half in enumerate(self.half):
            along, across = np.moveaxis(flat - self.centre[:, None, block], -1, 0)
            cosine, sine = np.cos(self.yaw[:, block, None]), np.sin(self.yaw[:, block, None])
            inside = np.abs(cosine * along + sine * across) <= half[0]
            inside &= np.abs(cosine * across - sine * along) <= half[1]
            np.maximum(out, np.where(inside, self.top[:, block, None], -np.inf), out=out)
        return out.reshape(points.shape[:-1])


def draw_terrain(kind: str, step: float, seed: int, first: int, count: int) -> Terrain:
    """
    Draw the terrain of `count` walks, of a `kind` out of `KINDS`.

    A walk with the same seed and number has its blocks at the same places for each step height.
    ``step`` is in metres: the rise of a stair, the height of the highest rubble, or the depth of a
    gap. ``first`` is the number of the first walk.
    """
    materials = load_materials()
    colours = np.array([materials[name] for name in _MATERIALS])
    sizes, draw, alike = KINDS[kind]
    half = np.array([_FLOOR, *sizes])
    blocks, looks = [], []
    for walk in range(first, first + count):
        rng = np.random.default_rng([seed, walk])
        blocks.append(draw(step, rng))
        floor, other = rng.choice(colours, 2)
        own = np.full(len(sizes), other) if alike else rng.choice(colours, len(sizes))
        looks.append(np.concatenate([[floor], own]))
    centre, yaw, top = (np.stack(values) for values in zip(*blocks, strict=True))
    # The ground before a gap is level with the robot's feet, so the floor is below it.
    floor_top = -step if kind == 'gaps' else 0.0
    return Terrain(
        half,
        np.pad(centre, ((0, 0), (1, 0), (0, 0))),
        np.pad(yaw, ((0, 0), (1, 0))),
        np.pad(top, ((0, 0), (1, 0)), constant_values=floor_top),
        np.stack(looks),
    )


def _across(along: np.ndarray, top: np.ndarray, rng: np.random.Generator) -> _Blocks:
    # Blocks whose centres are on a line that meets the robot's way at an angle.
    yaw = rng.uniform(-_YAW, _YAW)
    centre = np.outer(along - FIRST, [np.cos(yaw), np.sin(yaw)]) + [FIRST, 0.0]
    return centre, np.full(len(along), yaw), top


def _stairs(step: float, rng: np.random.Generator) -> _Blocks:
    number = np.arange(_STAIRS)
    along = rng.uniform(FIRST, LAST_FIRST) + _RUN * number + _STAIR[0]
    return _across(along, step * (number + 1.0), rng)


def _gaps(step: float, rng: np.random.Generator) -> _Blocks:
    first = rng.uniform(FIRST, LAST_FIRST)
    widths = rng.uniform(*_WIDTHS, len(_SLABS) - 1)
    ends = first + np.cumsum(widths) + _SLAB * np.arange(len(widths))  # far sides of the gaps
    along = np.concatenate([[first - _SLABS[0][0]], ends + [size[0] for size in _SLABS[1:]]])
    return _across(along, np.zeros(len(_SLABS)), rng)


def _rubble(step: float, rng: np.random.Generator) -> _Blocks:
    centre = np.stack([rng.uniform(*side, _BLOCKS) for side in _RUBBLE], axis=1)
    top = step * rng.uniform(_LOWEST, 1.0, _BLOCKS)
    return centre, rng.uniform(-np.pi, np.pi, _BLOCKS), top


_Size = tuple[float, float, float]
_STAIR: _Size = (1.5, 1.0, _HALF_HEIGHT)
_SLABS: tuple[_Size, ...] = (
    (1.0, 1.0, _HALF_HEIGHT),
    (_SLAB / 2, 1.0, _HALF_HEIGHT),
    (1.5, 1.0, _HALF_HEIGHT),
)
_SIZES: tuple[_Size, ...] = tuple(
    (float(x), float(y), _HALF_HEIGHT)
    for x, y in np.random.default_rng(940).uniform((0.05, 0.03), (0.15, 0.12), (_BLOCKS, 2))
)
# Half sizes of the blocks, how one walk's blocks are placed, and whether they are of one material.
KINDS: dict[
    str, tuple[tuple[_Size, ...], Callable[[float, np.random.Generator], _Blocks], bool]
] = {
    'stairs': ((_STAIR,) * _STAIRS, _stairs, True),
    'rubble': (_SIZES, _rubble, False),
    'gaps': (_SLABS, _gaps, True),
}

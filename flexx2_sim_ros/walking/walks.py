"""
Walks of a robot over terrain with footholds from what its cameras see, without forces.

All cameras look from the same poses: those of a robot that knows the ground. So the exact images
are rendered once for all cameras, and cameras differ only in the heights that they see.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from flexx2_sim_ros.batch.height_grid import HeightGrid
from flexx2_sim_ros.consumers.height_grid import LEAST
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.formulas import on_images, surfaces
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2, Mode
from flexx2_sim_ros.robots.kinematics import LegGeometry, rotation
from flexx2_sim_ros.robots.model import build_model
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import DEFAULT_ROBOT, load_robot, Robot
from flexx2_sim_ros.robots.trot import Gait, trunk_pose
from flexx2_sim_ros.walking.cameras import WalkingCamera, WalkViews
from flexx2_sim_ros.walking.footsteps import Feet, Footstep, footsteps, Grid, land, plan, roughness
from flexx2_sim_ros.walking.terrain import draw_terrain, Terrain
from flexx2_sim_ros.walking.terrain_view import render
import numpy as np
import warp as wp

_SPEED = 0.6  # m/s, below the largest of the gait (assumed)
_INTERVAL = 0.4  # seconds between looks (assumed): each place is seen in three or four of them
# Footholds between these places are chosen on the grid and judged, metres ahead of the start. The
# first is where the standing robot begins to see the floor, the last is on the last tread.
_FROM, _TO = 0.75, 2.0
_SEEN_FROM = 0.6  # metres ahead of the trunk's middle, where the image ends
# The grid has the formula and the reach of the grid of the paper's controller. Its points are half
# as far apart (5 cm), so that the cells cover the ground.
_PITCH = 0.05
_AHEAD = np.arange(0.3, 2.4, _PITCH)
_LEFT = np.arange(-6, 7) * _PITCH
# The robot uses no pixels that look at level ground at such an angle that the camera's noise model
# gives a larger sigma_z there, metres: at grazing incidence it grows without bound.
_SIGMA = 0.025

_model_sigma = on_images(surfaces.model_sigma)


@dataclass(frozen=True)
class Point:
    """
    Some walks over one kind of terrain with one step height.

    Attributes
    ----------
    terrain : str
        One of `terrain.KINDS`.
    step : float
        Metres.
    first, count : int
        Number of the first walk, and how many.

    """

    terrain: str
    step: float
    first: int
    count: int


def walk(
    point: Point,
    cameras: Mapping[str, WalkingCamera],
    lens: Intrinsics,
    mode: Mode,
    seed: int = 0,
    robot: str = DEFAULT_ROBOT,
    least: int = LEAST,
) -> dict[str, np.ndarray]:
    """
    Walk over terrain with footholds from what cameras see.

    Parameters
    ----------
    point : Point
        Which walks.
    cameras : mapping of str to WalkingCamera
        By name.
    lens : Intrinsics
        Of the images; the principal point in the middle, no distortion.
    mode : Mode
        Of the cameras; the robot uses its noise model.
    seed : int
        Of the terrain.
    robot : str
        Its name.
    least : int
        A cell of the grid with fewer points has no height.

    Returns
    -------
    dict of str to numpy.ndarray
        By camera: (N,) int, index in `REASONS` of why the walk failed, -1 where it did not.

    """
    legs, gait = legs_of(robot), Gait()
    terrain = draw_terrain(point.terrain, point.step, seed, point.first, point.count)
    steps = footsteps(_SPEED, _FROM, _TO, gait, legs)
    views = _views(point, terrain, steps, lens, load_robot(robot), gait, legs)
    return {
        name: _walk(_usable(camera(views), views, mode), views, steps, gait, legs, least)
        for name, camera in cameras.items()
    }


@lru_cache(maxsize=4)
def legs_of(robot: str) -> LegGeometry:
    """
    Return the legs of a robot's model.

    Raises InputError when the model does not have those of the robot's file.
    """
    kind = load_robot(robot)
    legs = find_parts(build_model(intrinsics=flexx2().intrinsics, robot=kind), kind).legs
    if legs is None:
        raise InputError(f'robot: must have the legs of its file in its model, got {robot}')
    return legs


def _start(count: int, steps: Sequence[Footstep], legs: LegGeometry, gait: Gait) -> Feet:
    # Each foot stands a stride before its first step, on the level ground of the start.
    first = {step.leg: step for step in reversed(steps)}
    places = np.array([first[leg].wanted for leg in range(4)])
    places[:, 0] -= _SPEED * gait.period
    return Feet(np.broadcast_to(places, (count, 4, 2)).copy(), np.zeros((count, 4)))


def _trunks(
    terrain: Terrain, steps: Sequence[Footstep], times: np.ndarray, gait: Gait, legs: LegGeometry
) -> tuple[np.ndarray, np.ndarray]:
    # Positions (L, N, 3) and rotations (L, N, 3, 3) of the trunk of a robot that knows the ground.
    count = len(terrain.top)
    points = np.stack(np.meshgrid(_AHEAD, _LEFT, indexing='ij'), axis=-1)
    true = terrain.heights(np.broadcast_to(points, (count, *points.shape)))
    grid, rough = Grid(_AHEAD, _LEFT, true), roughness(true)
    feet = _start(count, steps, legs, gait)
    under = np.zeros((len(times), count, 4))
    for step in steps:
        after, _ = land(
            plan(grid, rough, step, feet, gait, legs.foot_radius),
            step,
            feet,
            terrain,
            gait,
            legs.foot_radius,
        )
        # The trunk follows a foot during the whole time in the air, as in the gait.
        along = np.clip((times - step.lift) / (step.land - step.lift), 0.0, 1.0)
        eased = along**2 * (3 - 2 * along)
        change = after.heights[:, step.leg] - feet.heights[:, step.leg]
        under[:, :, step.leg] += eased[:, None] * change
        feet = after
    place = np.stack([_SPEED * times, np.zeros_like(times)], axis=-1)
    place = np.broadcast_to(place[:, None], (len(times), count, 2))
    position, rpy = trunk_pose(place, 0.0, under, legs)
    return position, rotation(rpy)


def _views(
    point: Point,
    terrain: Terrain,
    steps: Sequence[Footstep],
    lens: Intrinsics,
    robot: Robot,
    gait: Gait,
    legs: LegGeometry,
) -> WalkViews:
    times = np.arange(0.0, (_TO - _SEEN_FROM) / _SPEED, _INTERVAL)
    eyes = np.array([mount.position for mount in robot.mounts])
    axes = np.array([mount.rotation for mount in robot.mounts])

    def trunks(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Before the walk the robot stands.
        return _trunks(terrain, steps, np.maximum(moments, 0.0), gait, legs)

    def poses(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position, turn = trunks(moments)
        shift = np.einsum('lnij,cj->clni', turn, eyes)
        return position + shift, turn[None] @ axes[:, None, None]

    def earlier(seconds: float) -> tuple[np.ndarray, np.ndarray]:
        return render(terrain, lens, robot.mounts, *trunks(times - seconds))

    names = tuple(mount.name for mount in robot.mounts)
    return WalkViews(
        *earlier(0.0), earlier, *poses(times), poses, times, lens, names, terrain, point.first
    )


def _flattest(mode: Mode, height: float) -> float:
    # The sine of the smallest angle below the horizontal at which a pixel is used, `height` metres
    # above the ground.
    noise = mode.noise
    values = (noise.a, noise.b, noise.c, noise.d, noise.n, noise.incidence_cap)
    fall = np.linspace(0.05, 1.0, 500)
    sigma = _model_sigma(height / fall, fall, *values)
    return float(fall[sigma < _SIGMA].min(initial=1.0))


def _usable(depth: np.ndarray, views: WalkViews, mode: Mode) -> np.ndarray:
    # Depth without the pixels that are too noisy for a foothold.
    across, down = pixel_rays(views.lens)
    rays = np.stack([across, down, np.ones_like(across)], axis=-1)
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)
    least = np.float32(_flattest(mode, float(views.position[:, 0, :, 2].mean())))
    out = np.empty_like(depth)
    for index in np.ndindex(depth.shape[:3]):
        fall = -rays @ views.rotation[index][2].astype(np.float32)
        out[index] = np.where(fall >= least, depth[index], np.float32(np.nan))
    return out


def _walk(
    depth: np.ndarray,
    views: WalkViews,
    steps: Sequence[Footstep],
    gait: Gait,
    legs: LegGeometry,
    least: int,
) -> np.ndarray:
    cameras, looks, count = depth.shape[:3]
    heights = HeightGrid(count, views.lens, 'cpu', least=least, ahead=_AHEAD, left=_LEFT)
    feet = _start(count, steps, legs, gait)
    failed = np.full(count, -1)
    look, grid, rough = 0, Grid(_AHEAD, _LEFT, np.empty(0)), np.empty(0)
    for step in steps:
        fresh = look
        while look < looks and views.times[look] <= step.lift + 1e-9:
            for c in range(cameras):
                image = wp.array(depth[c, look], dtype=wp.float32, device='cpu')
                heights.add(image, views.position[c, look], views.rotation[c, look])
            look += 1
        if look > fresh or not rough.size:
            grid = Grid(_AHEAD, _LEFT, heights.heights().numpy().astype(float))
            rough = roughness(grid.heights)
        planned = plan(grid, rough, step, feet, gait, legs.foot_radius)
        feet, reason = land(planned, step, feet, views.terrain, gait, legs.foot_radius)
        failed = np.where(failed < 0, reason, failed)
    return failed

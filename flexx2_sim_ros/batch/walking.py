"""Many robots that walk through a scene, each on its own, without physics."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.consumers.height_grid import AHEAD, LEFT
from flexx2_sim_ros.rendering.rays import SceneGround
from flexx2_sim_ros.robots import gait
from flexx2_sim_ros.robots.kinematics import rotation
from flexx2_sim_ros.robots.parts import find_parts, RobotParts
from flexx2_sim_ros.robots.robot import Robot
from flexx2_sim_ros.robots.trot import Gait
import mujoco
import numpy as np

_TOP = 2.0  # metres, above all ground of the built-in scenes


@dataclass(frozen=True)
class Walk:
    """The paths of N robots, in F frames with C cameras."""

    qpos: np.ndarray  # (F, N, nq) states of the model
    # The optical frames in the frame of the robot's grid, which is under the trunk where it is at
    # last, looks ahead as it does then, and has the world's height.
    camera_position: np.ndarray  # (F, N, C, 3)
    camera_rotation: np.ndarray  # (F, N, C, 3, 3)
    heights: np.ndarray  # (N, 11, 7) the ground's height at the grid's points, metres


def walk(
    model: mujoco.MjModel,
    cameras: tuple[str, ...],
    num_envs: int,
    frames: int,
    interval: float,
    speed: float = 0.7,
    seed: int = 0,
    robot: Robot | None = None,
) -> Walk:
    """
    Let robots walk straight ahead, from random places on the scene's way along x.

    `model` is from `build_model`, of `robot` with legs (default `load_robot()`); `interval` is in
    seconds from frame to frame, `speed` in m/s; `seed` is of the places.
    """
    data = mujoco.MjData(model)
    parts = find_parts(model, robot)
    mujoco.mj_forward(model, data)
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name) for name in cameras]
    walker = _Walker(model, data, parts, SceneGround(model, data, parts.geoms), ids)
    generator = np.random.default_rng(seed % 2**64)
    walks = []
    for env in range(num_envs):
        back = env % 2  # Half of them walk the other way.
        place = np.array([generator.uniform(0.0, 3.3) + 1.7 * back, generator.uniform(-0.3, 0.3)])
        yaw = math.pi * back + generator.uniform(-0.15, 0.15)
        walks.append(_walk_alone(walker, place, yaw, speed, frames, interval))
    qpos, position, turn, heights = zip(*walks, strict=True)
    qpos, position, turn = (np.stack(one, axis=1) for one in (qpos, position, turn))
    return Walk(qpos, position, turn, np.stack(heights))


@dataclass(frozen=True)
class _Walker:
    # One robot in its scene, and the numbers of its cameras.
    model: mujoco.MjModel
    data: mujoco.MjData
    parts: RobotParts
    ground: SceneGround
    cameras: list[int]


def _walk_alone(
    walker: _Walker, place: np.ndarray, yaw: float, speed: float, frames: int, interval: float
) -> tuple[np.ndarray, ...]:
    # The fields of `Walk`, of one robot.
    model, data, parts, ground = walker.model, walker.data, walker.parts, walker.ground
    legs, how = parts.legs, Gait()
    assert legs is not None
    state = gait.start(place, yaw, _TOP, ground, legs)
    command = np.array([speed, 0.0, 0.0])
    qpos = np.empty((frames, model.nq))
    position = np.empty((frames, len(walker.cameras), 3))
    turn = np.empty((frames, len(walker.cameras), 3, 3))
    for frame in range(frames):
        state = gait.step(state, command, interval, ground, how, legs)
        pose = gait.pose(state, how, legs)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation(pose.rpy).ravel())
        parts.place(data, pose.position, quaternion)
        data.qpos[parts.leg_addresses] = pose.angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        qpos[frame] = data.qpos
        position[frame] = data.cam_xpos[walker.cameras]
        # MuJoCo's cameras look along -z with y up.
        turn[frame] = data.cam_xmat[walker.cameras].reshape(-1, 3, 3) * [1.0, -1.0, -1.0]
    level = rotation((0.0, 0.0, float(pose.rpy[2])))
    origin = np.array([*pose.position[:2], 0.0])
    grid = np.stack(np.meshgrid(AHEAD, LEFT, indexing='ij'), axis=-1)
    heights = ground.heights(origin[:2] + grid @ level[:2, :2].T, _TOP)
    return qpos, (position - origin) @ level, level.T @ turn, heights

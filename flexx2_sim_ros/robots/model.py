"""A robot in a scene with its cameras, as one MuJoCo model."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, one_sentence
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.pinholes import add_camera, check_view, FAR, NEAR, set_view
from flexx2_sim_ros.rendering.rays import SceneGround
from flexx2_sim_ros.rendering.scenes import load_scene, PREFIX, read_model
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import CameraMount, load_robot, Robot
import mujoco
import numpy as np

HOME_KEY = 'home'
MODELS = ('builtin', 'menagerie')
_CAMERA = 'flexx2.xml'  # in config/models, with the sizes and their source


def build_model(
    robot_model: str = 'builtin',
    scene: str = 'lab',
    *,
    intrinsics: Intrinsics,
    robot: Robot | None = None,
    mounts: Sequence[CameraMount] | None = None,
    near: float = NEAR,
    far: float = FAR,
) -> mujoco.MjModel:
    """
    Compose robot, scene and cameras.

    The robot's names, options and keyframes are kept. The scene's names get the prefix
    ``scene/``. Each mount gets a camera, attached to the trunk, and a massless housing.

    Parameters
    ----------
    robot_model : str
        ``builtin``, ``menagerie`` (the robot's model in the package mujoco-menagerie), or the path
        of an MJCF or URDF file with the robot's trunk.
    scene : str
        One of `flexx2_sim_ros.rendering.scenes.SCENES`, or the path of an MJCF file.
    intrinsics : Intrinsics
        Of every camera; the principal point in the middle, no distortion. They are those
        of the rendered images, not of the simulated camera.
    robot : Robot, optional
        Which robot it is; default `load_robot()`.
    mounts : sequence of CameraMount, optional
        The cameras; default the robot's own.
    near, far : float
        Clipping planes in metres, independent of the scene's size.

    Raises
    ------
    InputError
        When a file is missing, does not compile or has no trunk, when the parts do not fit
        together, or when the intrinsics cannot be rendered. The message has the parameter, the
        path and MuJoCo's message.

    """
    check_view(intrinsics, near, far)
    robot = robot or load_robot()
    spec, robot_path = _load_model(robot, robot_model)
    room, scene_path = load_scene(scene)
    trunk = spec.body(robot.trunk)
    if trunk is None:
        bodies = ', '.join(body.name for body in spec.bodies[1:9] if body.name) or 'none'
        raise InputError(
            f'robot_model: {robot_path}: must have a body named {robot.trunk!r}, got {bodies}'
        )
    with one_sentence(f'robot and scene: {robot_path} and {scene_path} do not fit together'):
        spec.attach(room, prefix=PREFIX, frame=spec.worldbody.add_frame())
        spec.add_material(name='flexx2_housing', rgba=[0.2, 0.21, 0.23, 1.0])
        for mount in robot.mounts if mounts is None else mounts:
            _add_camera(trunk, mount, intrinsics)
        set_view(spec, intrinsics, near, far)
        return spec.compile()


def _load_model(robot: Robot, value: str) -> tuple[mujoco.MjSpec, Path]:
    if value == 'builtin':
        path = robot.builtin
    else:
        path = _from_menagerie(robot) if value == 'menagerie' else Path(value)
    return read_model('robot_model', value, path, MODELS), path


def _from_menagerie(robot: Robot) -> Path:
    """Return the robot of MuJoCo Menagerie, which that package keeps or downloads."""
    name = robot.menagerie
    if not name:
        raise InputError(
            f"robot_model: 'menagerie' has no {robot.name}; must be builtin or a path"
        )
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise InputError(
            "robot_model: 'menagerie' needs the package mujoco-menagerie: pip install "
            'mujoco-menagerie, or take builtin'
        ) from error
    try:
        found = mujoco_menagerie.get(name)
        return Path(found.xml(found.default_model))
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise InputError(
            f"robot_model: 'menagerie' has no {name} on this machine and cannot download it "
            f'({error}); where there is a network, run: python -m mujoco_menagerie prefetch '
            f'{name}; or set MENAGERIE_ROOT to a checkout of MuJoCo Menagerie'
        ) from error


def _add_camera(trunk: Any, mount: CameraMount, intrinsics: Intrinsics) -> None:
    add_camera(trunk, mount.name, mount.position, mount.rotation, intrinsics)
    look = mount.rotation[:, 2]
    axes = np.stack([look, -mount.rotation[:, 0], -mount.rotation[:, 1]], axis=1)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    housing = mujoco.MjSpec.from_file(str(config_dir() / 'models' / _CAMERA)).geom('housing')
    trunk.add_geom(
        name=f'{mount.name}_housing',
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=housing.size,
        quat=quat,
        pos=np.asarray(mount.position) + housing.pos[0] * look,
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=2,
        material='flexx2_housing',
    )


def stand(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot | None = None) -> str:
    """
    Put the robot on its feet, at rest, and compute the state that depends on its pose.

    The pose is the key ``home`` with the trunk raised or lowered until the robot's lowest shape
    touches the ground below it; without such a key it is the model's initial pose ``qpos0``, with
    the legs in the robot's pose at rest. A robot that cannot move freely, or that has no ground
    below it, keeps its height.

    Parameters
    ----------
    model : mujoco.MjModel
        From `build_model`.
    data : mujoco.MjData
        Reset and filled, as after ``mj_forward``.
    robot : Robot, optional
        The one that the model was built with; default `load_robot()`.

    Returns
    -------
    str
        ``home`` or ``qpos0``: the pose that was used.

    """
    parts = find_parts(model, robot)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, HOME_KEY)
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
    else:
        mujoco.mj_resetData(model, data)
        if parts.legs is not None:
            data.qpos[parts.leg_addresses] = parts.legs.home
    mujoco.mj_forward(model, data)
    if parts.free >= 0:
        data.qpos[parts.free + 2] += _lift(model, data, parts.geoms, parts.trunk)
        mujoco.mj_forward(model, data)
    return HOME_KEY if key >= 0 or parts.legs is not None else 'qpos0'


def _lift(model: mujoco.MjModel, data: mujoco.MjData, own: np.ndarray, trunk: int) -> float:
    """Return how far the robot must rise so that its lowest shape touches the ground."""
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    geoms = np.flatnonzero(own & solid)
    bottoms = np.array([_bottom(model, data, int(geom)) for geom in geoms])
    # The ground is below the trunk; the initial height of the feet does not matter.
    ground = SceneGround(model, data, own)
    heights = ground.heights(data.geom_xpos[geoms, :2], float(data.xpos[trunk, 2]))
    lifts = (heights - bottoms)[~np.isnan(heights)]
    return float(lifts.max()) if lifts.size else 0.0


def _bottom(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Return the height of a geom's lowest point (exact for a sphere, else of its box)."""
    axis_z = data.geom_xmat[geom].reshape(3, 3)[2]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(data.geom_xpos[geom, 2] - model.geom_size[geom, 0])
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    return float(data.geom_xpos[geom, 2] + axis_z @ centre - np.abs(axis_z) @ half)

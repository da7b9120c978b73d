"""The simulated robot: a Go1 in a scene with its two front cameras, as one MuJoCo model."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.cameras import add_camera, check_view, FAR, NEAR, set_view
from flexx2_sim_ros.rendering.ground import SceneGround
from flexx2_sim_ros.rendering.scenes import load_scene, PREFIX, read_model
from flexx2_sim_ros.robots.kinematics import HOME, rotation
from flexx2_sim_ros.robots.robot import find_robot, ROOT_BODY
import mujoco
import numpy as np

HOME_KEY = 'home'
ROBOTS = ('builtin', 'menagerie')

# Size of the camera, 71.9 x 19.2 x 10.6 mm (data sheet), as half-sizes: depth, width, height.
_HOUSING = (0.0053, 0.03595, 0.0096)


@dataclass(frozen=True)
class CameraMount:
    """
    Where a camera sits on the robot.

    Attributes
    ----------
    name : str
        The camera's name in the model, e.g. ``front_left``.
    position : tuple of float
        The lens in the trunk's frame (x forward, y left, z up), metres.
    rpy : tuple of float
        Roll, pitch, yaw in radians, rotations about the fixed x, y and z axes in this order.
        Zero looks along the trunk's x axis, upright; positive pitch looks down.

    """

    name: str
    position: tuple[float, float, float]
    rpy: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Refuse what cannot be a pose."""
        if not (isinstance(self.name, str) and self.name):
            raise InputError(f'camera name: found {shown(self.name)}, wanted a non-empty string')
        for field in ('position', 'rpy'):
            value = getattr(self, field)
            if len(value) != 3 or not all(
                isinstance(v, (int, float)) and math.isfinite(v) for v in value
            ):
                raise InputError(
                    f'camera {self.name}: {field} is {shown(value)}, wanted three finite numbers'
                )

    @property
    def rotation(self) -> np.ndarray:
        """Return (3, 3) float64: the optical axes x right, y down, z forward in the trunk."""
        body = rotation(self.rpy)
        return np.stack([-body[:, 1], -body[:, 2], body[:, 0]], axis=1)


def load_mounts(path: str | Path | None = None) -> tuple[CameraMount, ...]:
    """
    Read the cameras' poses.

    Parameters
    ----------
    path : str or pathlib.Path, optional
        A file like ``config/go1.yaml``, which is the default.

    Returns
    -------
    tuple of CameraMount
        At least one, with distinct names.

    Raises
    ------
    InputError
        When the file cannot be read or a field is missing or wrong.

    """
    path = config_dir() / 'go1.yaml' if path is None else Path(path)
    entries = read_section(path, 'cameras', list)
    mounts = tuple(_mount(entry, f'{path}: cameras[{i}]') for i, entry in enumerate(entries))
    names = [mount.name for mount in mounts]
    if len(set(names)) != len(names):
        raise InputError(f'{path}: camera names are {names}, wanted no name twice')
    return mounts


def _mount(entry: Any, where: str) -> CameraMount:
    fields = {'name', 'position', 'rpy_deg'}
    if not isinstance(entry, dict) or set(entry) != fields:
        raise InputError(
            f'{where} is {shown(entry)}, wanted the fields {", ".join(sorted(fields))}'
        )
    try:
        x, y, z = entry['position']
        roll, pitch, yaw = map(math.radians, entry['rpy_deg'])
        return CameraMount(entry['name'], (x, y, z), (roll, pitch, yaw))
    except (TypeError, ValueError) as error:
        raise InputError(
            f'{where} is {shown(entry)}, wanted a name and two triples of numbers: {error}'
        ) from error


def build_model(
    robot: str = 'builtin',
    scene: str = 'lab',
    *,
    intrinsics: Intrinsics,
    mounts: Sequence[CameraMount] | None = None,
    near: float = NEAR,
    far: float = FAR,
) -> mujoco.MjModel:
    """
    Compose robot, scene and cameras.

    The robot's file leads: its names, options and keys stay as they are. The scene's names get
    the prefix ``scene/``.

    Parameters
    ----------
    robot : str
        ``builtin``, ``menagerie`` (the Go1 of the package mujoco-menagerie), or the path of an
        MJCF or URDF file with a body ``trunk``.
    scene : str
        One of `flexx2_sim_ros.rendering.scenes.SCENES`, or the path of an MJCF file.
    intrinsics : Intrinsics
        Of every camera; the principal point in the middle, no distortion. These are the pictures
        that are rendered, not what the simulated camera makes of them.
    mounts : sequence of CameraMount, optional
        The cameras; default `load_mounts()`.
    near, far : float
        Clipping planes in metres, whatever the scene's size.

    Returns
    -------
    mujoco.MjModel
        With one camera a mount, attached to ``trunk``, and its housing as a massless shape.

    Raises
    ------
    InputError
        When a file is missing, does not compile or has no ``trunk``, when the parts do not fit
        together, or when the intrinsics cannot be rendered. It names the parameter and the path
        and carries MuJoCo's own message.

    """
    check_view(intrinsics, near, far)
    spec, robot_path = _load_robot(robot)
    room, scene_path = load_scene(scene)
    trunk = spec.body(ROOT_BODY)
    if trunk is None:
        bodies = ', '.join(body.name for body in spec.bodies[1:9] if body.name) or 'none'
        raise InputError(f'robot: {robot_path} has no body named {ROOT_BODY!r}; found {bodies}')
    try:
        spec.attach(room, prefix=PREFIX, frame=spec.worldbody.add_frame())
        spec.add_material(name='flexx2_housing', rgba=[0.2, 0.21, 0.23, 1.0])
        for mount in load_mounts() if mounts is None else mounts:
            _add_camera(trunk, mount, intrinsics)
        set_view(spec, intrinsics, near, far)
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(
            f'robot and scene: {robot_path} and {scene_path} do not fit together: {error}'
        ) from error


def _load_robot(value: str) -> tuple[mujoco.MjSpec, Path]:
    if value == 'builtin':
        path = config_dir() / 'models' / 'go1.xml'
    else:
        path = _menagerie_go1() if value == 'menagerie' else Path(value)
    return read_model('robot', value, path, ROBOTS), path


def _menagerie_go1() -> Path:
    """Return the Go1 of MuJoCo Menagerie, which that package keeps or downloads."""
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise InputError(
            "robot: 'menagerie' needs the package mujoco-menagerie: pip install "
            'mujoco-menagerie, or take builtin'
        ) from error
    robot = mujoco_menagerie.get('unitree_go1')
    try:
        return Path(robot.xml(robot.default_model))
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise InputError(
            f"robot: 'menagerie' has no unitree_go1 on this machine and cannot download it "
            f'({error}); where there is a network, run: python -m mujoco_menagerie prefetch '
            'unitree_go1; or set MENAGERIE_ROOT to a checkout of MuJoCo Menagerie'
        ) from error


def _add_camera(trunk: Any, mount: CameraMount, intrinsics: Intrinsics) -> None:
    add_camera(trunk, mount.name, mount.position, mount.rotation, intrinsics)
    look = mount.rotation[:, 2]
    axes = np.stack([look, -mount.rotation[:, 0], -mount.rotation[:, 1]], axis=1)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    trunk.add_geom(
        name=f'{mount.name}_housing',
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=_HOUSING,
        quat=quat,
        # The lens is 1 mm in front of the housing, which therefore never is in its own view.
        pos=np.asarray(mount.position) - (_HOUSING[0] + 0.001) * look,
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=2,
        material='flexx2_housing',
    )


def stand(model: mujoco.MjModel, data: mujoco.MjData) -> str:
    """
    Put the robot on its feet, at rest, and compute everything that follows from its pose.

    The pose is the key ``home`` with the trunk raised or lowered until the robot's lowest shape
    touches the ground below it; without such a key it is the model's initial pose ``qpos0``, with
    a Go1's legs as in ``home``. A robot that cannot move freely, or that has no ground below it,
    keeps its height.

    Parameters
    ----------
    model : mujoco.MjModel
        From `build_model`.
    data : mujoco.MjData
        Reset and filled, as after ``mj_forward``.

    Returns
    -------
    str
        ``home`` or ``qpos0``: the pose that was taken.

    """
    robot = find_robot(model)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, HOME_KEY)
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
    else:
        mujoco.mj_resetData(model, data)
        if robot.legs is not None:
            data.qpos[robot.leg_addresses()] = HOME
    mujoco.mj_forward(model, data)
    if robot.free >= 0:
        data.qpos[robot.free + 2] += _lift(model, data, robot.geoms, robot.trunk)
        mujoco.mj_forward(model, data)
    return HOME_KEY if key >= 0 or robot.legs is not None else 'qpos0'


def _lift(model: mujoco.MjModel, data: mujoco.MjData, own: np.ndarray, trunk: int) -> float:
    """Return by how much the robot must rise for its lowest shape to touch the ground."""
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    geoms = np.flatnonzero(own & solid)
    bottoms = np.array([_bottom(model, data, int(geom)) for geom in geoms])
    # The ground is what lies below the trunk, wherever the robot's file put its feet.
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

"""
Scenes, from files in ``config/models`` or built here, and the reflectivity of their surfaces.

In each scene the robot stands at the origin and faces +x. The ground below it is at height 0.
"""

from html import unescape
from pathlib import Path
import re

from flexx2_sim_ros.config_file import is_regular_file, read_section
from flexx2_sim_ros.errors import InputError, one_sentence, shown, shown_path
from flexx2_sim_ros.paths import config_dir
import mujoco
import numpy as np

SCENES = ('lab', 'stairs', 'corner', 'board', 'rubble')
# Names in a scene get this prefix in the whole model.
PREFIX = 'scene/'
# Half-sizes of the white board and of the backdrop: depth, width, height, metres.
BOARD_HALF_SIZE = (0.01, 0.6, 0.45)
_BACKDROP_HALF_SIZE = (0.02, 8.0, 8.0)
BACKDROP_BEHIND = 1.5
BOARD_DISTANCES = (0.1, 10.0)
LARGEST_BOARD_ANGLE = 80.0

_COLOURS = {
    'floor': (0.46, 0.47, 0.48),
    'wall_paint': (0.85, 0.84, 0.80),
    'white_board': (0.95, 0.95, 0.95),
    'concrete': (0.55, 0.55, 0.52),
    'brick': (0.60, 0.30, 0.22),
    'wood': (0.72, 0.53, 0.34),
    'metal': (0.62, 0.65, 0.70),
    'black': (0.05, 0.05, 0.05),
}
# MuJoCo's default colour: a geom of this colour takes the colour of its material.
_NO_COLOUR = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
# Attributes of MJCF and URDF that name files and folders.
_PART = re.compile(r"""\b(file\w*|\w*dir)\s*=\s*["']([^"']+)""")
_BOX = mujoco.mjtGeom.mjGEOM_BOX


def load_scene(scene: str) -> tuple[mujoco.MjSpec, str]:
    """
    Return a scene to attach to a robot, and its name or path, for messages.

    ``scene`` is one of `SCENES`, or the path of an MJCF file; it compiles without a robot. Raises
    InputError when there is no such scene or it does not compile.
    """
    builders = {'board': _board, 'rubble': _rubble}
    if scene in builders:
        return builders[scene](), f'the built-in scene {scene!r}'
    path = config_dir() / 'models' / f'{scene}.xml' if scene in SCENES else Path(scene)
    return read_model('scene', scene, path, SCENES), str(path)


def read_model(parameter: str, value: str, path: Path, names: tuple[str, ...]) -> mujoco.MjSpec:
    """Read an MJCF or URDF file and compile it alone, so that errors name the right file."""
    if not is_regular_file(path):
        raise InputError(
            f'{parameter}: must be {", ".join(map(repr, names))} or the path of an MJCF file, '
            f'got {shown(value, 160)}'
        )
    with one_sentence(f'{parameter}: {path} does not compile'):
        _check_parts(path, path.parent, set())
        spec = mujoco.MjSpec.from_file(str(path))
        if path.suffix.lower() == '.urdf':
            _free_urdf(spec)
        spec.compile()
    return spec


def _check_parts(path: Path, base: Path, checked: set[Path]) -> None:
    # MuJoCo waits for ever for a pipe, so all files that a model names are looked at first.
    checked.add(path)
    found = [(key, unescape(value)) for key, value in _PART.findall(path.read_text('latin-1'))]
    folders = [base, *(base / value for key, value in found if key.endswith('dir'))]
    names = [value for key, value in found if key.startswith('file')]
    for part in {folder / name for name in names for folder in folders}:
        for one in (part, base / part.name):
            if one.exists() and not (is_regular_file(one) or one.is_dir()):
                raise InputError(f'{shown_path(one)}: must be an ordinary file')
        model = part.suffix in ('.xml', '.mjcf', '.urdf') and part not in checked
        if model and is_regular_file(part):
            _check_parts(part, base, checked)


def _free_urdf(spec: mujoco.MjSpec) -> None:
    # A URDF does not tell whether its root is free; a robot's is. Links that are fixed to each
    # other must stay separate: otherwise `trunk` is merged into its parent.
    spec.compiler.fusestatic = False
    for body in spec.worldbody.bodies:
        if not body.joints:
            body.add_freejoint()


def place_board(
    model: mujoco.MjModel, data: mujoco.MjData, camera: str, distance: float, angle: float
) -> None:
    """
    Place the board of the scene `board` in front of a camera.

    The board's front face crosses the camera's optical axis at `distance`, 0.1 to 10 m, and the
    angle between its normal and the axis is `angle`, -80 to 80 degrees. The board is turned about
    the image's vertical, with the right edge away from the camera. The face's depth at pixel (u,
    v) is exactly ``distance / (1 - tan(angle) (u - cx) / fx)``. A backdrop stands 1.5 m behind it,
    square to the axis. Other cameras see both from their own positions.

    The board's place in ``model`` is changed permanently. ``data`` has the robot in its pose,
    complete up to its positions; it is updated. Raises InputError when the model has no board or
    no such camera, or a number is out of range.
    """
    near, far = BOARD_DISTANCES
    if not near <= distance <= far:
        raise InputError(f'board_distance: must be {near:g} to {far:g} metres, got {distance}')
    if not abs(angle) <= LARGEST_BOARD_ANGLE:
        raise InputError(
            f'board_angle_deg: must be -{LARGEST_BOARD_ANGLE:g} to {LARGEST_BOARD_ANGLE:g}, '
            f'got {angle}'
        )
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    if index < 0:
        names = [model.cam(i).name for i in range(model.ncam)]
        raise InputError(f'board_camera: must be one of {", ".join(names)}, got {shown(camera)}')
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f'{PREFIX}board') < 0:
        raise InputError("scene: must be 'board', got one without a board")
    lens = data.cam_xpos[index]
    right, up, back = data.cam_xmat[index].reshape(3, 3).T
    turn = np.radians(angle)
    normal = np.cos(turn) * back + np.sin(turn) * right
    _move(model, data, 'board', lens - distance * back - BOARD_HALF_SIZE[0] * normal, normal, up)
    behind = distance + BACKDROP_BEHIND + _BACKDROP_HALF_SIZE[0]
    _move(model, data, 'backdrop', lens - behind * back, back, up)
    mujoco.mj_forward(model, data)


def _move(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    name: str,
    position: np.ndarray,
    normal: np.ndarray,
    up: np.ndarray,
) -> None:
    body = model.body(f'{PREFIX}{name}').id
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([normal, np.cross(up, normal), up], axis=1).ravel())
    mocap = model.body_mocapid[body]
    data.mocap_pos[mocap], data.mocap_quat[mocap] = position, quaternion
    # Also in the model and its keyframes, so that a reset keeps it.
    model.body_pos[body], model.body_quat[body] = position, quaternion
    model.key_mpos.reshape(model.nkey, model.nmocap, 3)[:, mocap] = position
    model.key_mquat.reshape(model.nkey, model.nmocap, 4)[:, mocap] = quaternion


def _empty(name: str) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.visual.headlight.ambient = spec.visual.headlight.diffuse = [0.35] * 3
    spec.worldbody.add_light(pos=[-1, 0, 4], dir=[0.4, 0, -1], diffuse=[0.7] * 3)
    for material, colour in _COLOURS.items():
        spec.add_material(name=material, rgba=[*colour, 1.0])
    return spec


def _board() -> mujoco.MjSpec:
    """
    Build the paper's white board, with nothing else in view.

    The cameras look down, and the board may be 10 m away on their optical axes. So there is no
    floor, and the robot stands on a pedestal that is too small for the cameras to see.
    """
    spec = _empty('board')
    spec.worldbody.add_geom(
        name='pedestal',
        type=_BOX,
        size=[0.45, 0.35, 2.0],
        pos=[-0.05, 0.0, -2.0],
        material='concrete',
    )
    for name, size, material, x in (
        ('board', BOARD_HALF_SIZE, 'white_board', 1.3),
        ('backdrop', _BACKDROP_HALF_SIZE, 'wall_paint', 2.8),
    ):
        body = spec.worldbody.add_body(name=name, pos=[x, 0.0, 0.3], mocap=True)
        body.add_geom(name=name, type=_BOX, size=size, material=material)
    return spec


def _rubble() -> mujoco.MjSpec:
    """Build a field of bricks, planks and pipes at random angles with a fixed seed."""
    spec = _empty('rubble')
    world = spec.worldbody
    world.add_geom(
        name='floor', type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], material='floor'
    )
    for name, x, y, length, width in (
        ('ahead', 5.05, 0.0, 0.05, 2.3),
        ('left', 2.05, 2.25, 3.0, 0.05),
        ('right', 2.05, -2.25, 3.0, 0.05),
    ):
        world.add_geom(
            name=f'wall_{name}',
            type=_BOX,
            size=[length, width, 0.8],
            pos=[x, y, 0.8],
            material='wall_paint',
        )
    spec.compiler.degree = False
    random = np.random.default_rng(940)
    for number in range(80):
        place = random.uniform((0.6, -1.4), (4.0, 1.4))
        turn = random.uniform(-np.pi, np.pi)
        if number % 5 == 4:
            radius, half = random.uniform((0.015, 0.1), (0.03, 0.35))
            along = half * np.array([np.cos(turn), np.sin(turn)])
            world.add_geom(
                name=f'pipe_{number}',
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                fromto=[*(place - along), radius, *(place + along), radius],
                size=[radius, 0, 0],
                material=('metal', 'black')[number // 5 % 2],
            )
        else:
            size = random.uniform((0.05, 0.03, 0.015), (0.20, 0.11, 0.05))
            world.add_geom(
                name=f'block_{number}',
                type=_BOX,
                size=size,
                pos=[*place, size[2] * random.uniform(0.3, 1.0)],
                euler=[*random.normal(0.0, 0.12, 2), turn],
                material=('concrete', 'brick', 'wood')[number % 3],
            )
    return spec


def load_materials(path: str | Path | None = None) -> dict[str, float]:
    """
    Read the diffuse reflectivities at 940 nm, 0 to 1, by material name.

    The file is like ``config/materials.yaml``, which is the default. Raises InputError when it
    cannot be read or an entry is not a number from 0 to 1.
    """
    path = config_dir() / 'materials.yaml' if path is None else Path(path)
    entries = read_section(path, 'materials', dict)
    table = {}
    for name, entry in entries.items():
        value = entry.get('reflectivity') if isinstance(entry, dict) else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 1:
            raise InputError(
                f'{path}: materials.{name}.reflectivity: must be a number from 0 to 1, '
                f'got {shown(value)}'
            )
        table[str(name)] = float(value)
    return table


def reflectivity_table(
    model: mujoco.MjModel, materials: dict[str, float] | None = None
) -> np.ndarray:
    """
    Return every geom's reflectivity at 940 nm, to be indexed with a renderer's ``geom_id``.

    It is (ngeom + 1,) float32, 0 to 1. A geom without a listed material takes the Rec. 709
    luminance of its colour. The last entry, which id -1 picks, is 0. ``materials`` is reflectivity
    by name, of which the part after the last ``/`` counts; default `load_materials()`.
    """
    materials = load_materials() if materials is None else materials
    table = np.zeros(model.ngeom + 1, np.float32)
    for geom in range(model.ngeom):
        material = model.geom_matid[geom]
        rgba = model.geom_rgba[geom]
        name = ''
        if material >= 0:
            name = model.mat(material).name.rsplit('/', 1)[-1]
            if np.array_equal(rgba, _NO_COLOUR):
                rgba = model.mat_rgba[material]
        table[geom] = materials.get(name, float(rgba[:3] @ (0.2126, 0.7152, 0.0722)))
    return table.clip(0.0, 1.0)

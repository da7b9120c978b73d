"""A robot: its models, the names of its parts, its pose at rest and its cameras."""

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import is_regular_file, read_config, read_section
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.limits import is_finite
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.robots.kinematics import rotation
import numpy as np

DEFAULT_ROBOT = 'go1'
_LEGS, _PARTS = 4, 3


@dataclass(frozen=True)
class CameraMount:
    """
    The pose of a camera on the robot.

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
        """Refuse values that are not a pose."""
        if not (isinstance(self.name, str) and self.name):
            raise InputError(f'camera name: must be a non-empty string, got {shown(self.name)}')
        for field in ('position', 'rpy'):
            value = getattr(self, field)
            if len(value) != 3 or not all(map(is_finite, value)):
                raise InputError(
                    f'camera {self.name}: {field}: must be three finite numbers, got '
                    f'{shown(value)}'
                )

    @property
    def rotation(self) -> np.ndarray:
        """Return (3, 3) float64: the optical axes x right, y down, z forward in the trunk."""
        body = rotation(self.rpy)
        return np.stack([-body[:, 1], -body[:, 2], body[:, 0]], axis=1)


@dataclass(frozen=True)
class LegJoints:
    """
    The joints of four legs.

    Attributes
    ----------
    names : tuple
        (4, 3) names: hip, thigh and calf of the legs front right, front left, rear right and rear
        left.
    home : tuple of float
        Hip, thigh and calf of a leg at rest, radians.
    limits : tuple of tuple of float
        Least and greatest angle of hip, thigh and calf, radians, where a model has no limits.

    """

    names: tuple[tuple[str, ...], ...]
    home: tuple[float, ...]
    limits: tuple[tuple[float, ...], ...]

    @property
    def all_names(self) -> tuple[str, ...]:
        """Return the twelve names, leg by leg."""
        return tuple(name for leg in self.names for name in leg)


@dataclass(frozen=True)
class Robot:
    """
    A robot: everything that differs between robots.

    Lengths, masses and shapes are in its models.

    Attributes
    ----------
    name : str
        E.g. ``go1``.
    builtin : pathlib.Path
        The MJCF file of its built-in model.
    menagerie : str
        Its name in MuJoCo Menagerie; empty when it has none.
    trunk : str
        The body in its models that carries the cameras and whose pose is the robot's.
    legs : LegJoints or None
        None for a robot without legs that `flexx2_sim_ros.robots.gait` can move.
    mounts : tuple of CameraMount
        Its default cameras.

    """

    name: str
    builtin: Path
    menagerie: str
    trunk: str
    legs: LegJoints | None
    mounts: tuple[CameraMount, ...]


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots in ``config/robots``."""
    return tuple(sorted(path.stem for path in (config_dir() / 'robots').glob('*.yaml')))


def robot_path(name: str) -> Path:
    """Return the file of a robot in ``config/robots``."""
    return config_dir() / 'robots' / f'{name}.yaml'


def load_robot(robot: str | Path = DEFAULT_ROBOT) -> Robot:
    """
    Read a robot's file.

    Parameters
    ----------
    robot : str or pathlib.Path
        One of `robot_names`, or the path of a file like ``config/robots/go1.yaml``.

    Raises
    ------
    InputError
        When there is no such robot, or a field of its file is missing or wrong.

    """
    names = robot_names()
    path = robot_path(str(robot)) if robot in names else Path(robot)
    if not is_regular_file(path):
        raise InputError(
            f'robot: must be {", ".join(names)} or the path of a YAML file, '
            f'got {shown_path(robot)}'
        )
    found = read_config(path)
    where = f'robot: {shown_path(path)}'
    models = found.get('models')
    if not isinstance(models, dict):
        raise InputError(f'{where}: models: must be a mapping, got {shown(models)}')
    return Robot(
        name=path.stem,
        builtin=path.parent / _text(models, 'builtin', f'{where}: models'),
        menagerie=_text(models, 'menagerie', f'{where}: models') if 'menagerie' in models else '',
        trunk=_text(found, 'trunk', where),
        legs=_legs(found['legs'], f'{where}: legs') if 'legs' in found else None,
        mounts=load_mounts(path),
    )


def load_mounts(path: str | Path | None = None) -> tuple[CameraMount, ...]:
    """
    Read the cameras' poses.

    Parameters
    ----------
    path : str or pathlib.Path, optional
        A robot's file; only its section ``cameras`` is read. Default: that of `DEFAULT_ROBOT`.

    Returns
    -------
    tuple of CameraMount
        At least one, with distinct names.

    Raises
    ------
    InputError
        When the file cannot be read or a field is missing or wrong.

    """
    path = robot_path(DEFAULT_ROBOT) if path is None else Path(path)
    entries = read_section(path, 'cameras', list)
    mounts = tuple(_mount(entry, f'{path}: cameras[{i}]') for i, entry in enumerate(entries))
    names = [mount.name for mount in mounts]
    if len(set(names)) != len(names):
        raise InputError(f'{path}: camera names: must be unique, got {names}')
    return mounts


def _mount(entry: Any, where: str) -> CameraMount:
    fields = {'name', 'position', 'rpy_deg'}
    if not isinstance(entry, dict) or set(entry) != fields:
        raise InputError(
            f'{where}: must have the fields {", ".join(sorted(fields))}, got {shown(entry)}'
        )
    try:
        x, y, z = entry['position']
        roll, pitch, yaw = map(math.radians, entry['rpy_deg'])
        return CameraMount(entry['name'], (x, y, z), (roll, pitch, yaw))
    except (OverflowError, TypeError, ValueError) as error:
        raise InputError(
            f'{where}: must be a name and two triples of numbers, got {shown(entry)}: {error}'
        ) from error


def _text(fields: dict[str, Any], key: str, where: str) -> str:
    value = fields.get(key)
    if not (isinstance(value, str) and value):
        raise InputError(f'{where}: {key}: must be a non-empty text, got {shown(value)}')
    return value


def _legs(found: Any, where: str) -> LegJoints:
    wanted = {'joints', 'home', 'limits'}
    if not isinstance(found, dict) or set(found) != wanted:
        raise InputError(
            f'{where}: must have the fields {", ".join(sorted(wanted))}, got {shown(found)}'
        )
    names = found['joints']
    if not (
        isinstance(names, list)
        and len(names) == _LEGS
        and all(isinstance(leg, list) and len(leg) == _PARTS for leg in names)
        and all(isinstance(name, str) for leg in names for name in leg)
    ):
        raise InputError(f'{where}: joints: must be {_LEGS} x {_PARTS} names, got {shown(names)}')
    limits = found['limits']
    if not (isinstance(limits, list) and len(limits) == _PARTS):
        raise InputError(
            f'{where}: limits: must be {_PARTS} pairs of numbers, got {shown(limits)}'
        )
    return LegJoints(
        names=tuple(map(tuple, names)),
        home=_numbers(found['home'], _PARTS, f'{where}: home'),
        limits=tuple(_numbers(pair, 2, f'{where}: limits') for pair in limits),
    )


def _numbers(value: Any, count: int, where: str) -> tuple[float, ...]:
    is_list = isinstance(value, list) and len(value) == count
    if not (is_list and all(map(is_finite, value))):
        raise InputError(f'{where}: must be {count} finite numbers, got {shown(value)}')
    return tuple(map(float, value))

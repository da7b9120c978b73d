"""The parameters of `go1_cameras`."""

from collections.abc import Callable, Sequence
import math
import re
from typing import Any

from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.nodes.parameters import declare
from flexx2_sim_ros.profiles.files import PROFILE_HELP
from flexx2_sim_ros.rendering.renderer import BACKENDS
from flexx2_sim_ros.rendering.scenes import BOARD_DISTANCES, LARGEST_BOARD_ANGLE, SCENES
from flexx2_sim_ros.robots.model import MODELS
from flexx2_sim_ros.robots.robot import CameraMount, DEFAULT_ROBOT, load_robot, robot_names
from flexx2_sim_ros.robots.trot import Gait
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

MOTIONS = ('stand', 'cmd_vel', 'external')

_NAME = re.compile('[A-Za-z_][A-Za-z0-9_]*')
# Parameters that can change while the node runs: default, least, greatest, description.
_NUMBERS = {
    'real_time_factor': (1.0, 0.01, 100.0, 'Simulated seconds in a second.'),
    'max_speed': (Gait.max_speed, 0.0, 1.2, 'Fastest walk in any direction, m/s.'),
    'max_turn': (Gait.max_turn, 0.0, 2.5, 'Fastest turn, rad/s.'),
    'board_distance': (
        1.0,
        *BOARD_DISTANCES,
        'Of the board along the optical axis of board_camera, metres.',
    ),
    'board_angle_deg': (
        0.0,
        -LARGEST_BOARD_ANGLE,
        LARGEST_BOARD_ANGLE,
        'Incidence angle at the axis, degrees; above 0 the right edge is away.',
    ),
}


class RobotParameters:
    """
    Declare, check and hold the parameters of the robot node; attributes are as given.

    ``rate`` is in Hz of each camera. ``follows_clock`` says whether time comes from another node's
    ``/clock``; the node sets it. Raises InputError when a value given at the start cannot be used.
    """

    def __init__(self, node: Node) -> None:
        """Declare all parameters; values given on the command line apply."""
        self._node = node
        self.rate: float = self._fixed('rate', 60.0, 'Frames a second of each camera, Hz.')
        if not 0.001 <= self.rate <= 1000:
            raise InputError(f'rate: must be 0.001 to 1000 Hz, got {self.rate}')
        self.motion: str = self._choice('motion', MOTIONS, 'Where the pose comes from.')
        names = ', '.join(robot_names())
        self.robot = load_robot(
            self._fixed('robot', DEFAULT_ROBOT, f'{names}, or the path of a YAML file.')
        )
        self.profile: str = self._fixed(
            'profile', '', f'{PROFILE_HELP[0].upper()}{PROFILE_HELP[1:]}. For its intrinsics.'
        )
        path = ', or the path of an MJCF file'
        self.robot_model: str = self._fixed(
            'robot_model', 'builtin', f'{", ".join(MODELS)}{path} or URDF.'
        )
        self.scene: str = self._fixed('scene', 'lab', f'{", ".join(SCENES)}{path}.')
        self.renderer: str = self._choice('renderer', BACKENDS, 'How to render.')
        self.publish_clock: bool = self._fixed(
            'publish_clock',
            True,
            'Whether to publish /clock; never when motion is external, and '
            'where another robot publishes it this one follows.',
        )
        self.frame_prefix: str = self._fixed('frame_prefix', '', 'What all frames begin with.')
        self.follows_clock = False
        self.mounts = self._declare_mounts(self.robot.mounts)
        self.board_camera: str = self._fixed(
            'board_camera', self.mounts[0].name, 'Camera that the board stands in front of.'
        )
        self.paused: bool = declare(node, 'paused', False, 'Whether simulated time stands still.')
        for name, (default, least, most, text) in _NUMBERS.items():
            value = declare(node, name, default, f'{text} From {least:g} to {most:g}.')
            _check_number(name, value)

    def watch(self, on_change: Callable[[], None]) -> None:
        """Check changes from now on, and call `on_change` after each change."""

        def apply(parameters: list[Parameter]) -> None:
            self.paused = bool(self._node.get_parameter('paused').value)
            if any(parameter.name in (*_NUMBERS, 'paused') for parameter in parameters):
                on_change()

        self._node.add_on_set_parameters_callback(self._validate)
        self._node.add_post_set_parameters_callback(apply)

    def number(self, name: str) -> float:
        """Return the present value of a number that can change."""
        return float(self._node.get_parameter(name).value)

    def gait(self) -> Gait:
        """Return the present limits and timing of the gait."""
        return Gait(max_speed=self.number('max_speed'), max_turn=self.number('max_turn'))

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name not in _NUMBERS:
                    continue
                _check_number(parameter.name, parameter.value)
                if parameter.value == self._node.get_parameter(parameter.name).value:
                    continue  # A file of all parameters may be loaded, see `ros2 param dump`.
                if parameter.name.startswith('board_') and self.scene != 'board':
                    raise InputError(
                        f'{parameter.name}: must be set in scene board only, got scene '
                        f'{shown(self.scene)}'
                    )
                if parameter.name == 'real_time_factor' and self.motion == 'external':
                    raise InputError(
                        'real_time_factor: must be set in the simulator that has the time '
                        '(motion is external), got it here'
                    )
                if parameter.name == 'real_time_factor' and self.follows_clock:
                    raise InputError(
                        'real_time_factor: must be set where /clock is published, got it here'
                    )
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _fixed(self, name: str, default: Any, description: str) -> Any:
        return declare(self._node, name, default, description, read_only=True)

    def _choice(self, name: str, choices: tuple[str, ...], description: str) -> str:
        value: str = self._fixed(name, choices[0], f'{description} One of {", ".join(choices)}.')
        if value not in choices:
            raise InputError(f'{name}: must be one of {", ".join(choices)}, got {shown(value)}')
        return value

    def _declare_mounts(self, defaults: Sequence[CameraMount]) -> list[CameraMount]:
        poses = {mount.name: mount for mount in defaults}
        names = self._fixed('cameras', list(poses), 'Names of the cameras.')
        if not names or len(set(names)) != len(names) or not all(map(_NAME.fullmatch, names)):
            raise InputError(
                'cameras: must be unique names of letters, digits and underscores that do '
                f'not begin with a digit, got {list(names)}'
            )
        mounts = []
        for name in names:
            start = poses.get(name, CameraMount(name, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0)))
            position = self._fixed(
                f'{name}.position',
                # A file may have whole numbers; ROS takes a list of one type only.
                [float(value) for value in start.position],
                'Lens in the trunk frame (x forward, y left, z up), metres.',
            )
            rpy = self._fixed(
                f'{name}.rpy_deg',
                [math.degrees(a) for a in start.rpy],
                'Roll, pitch (down), yaw (left) in degrees.',
            )
            for field, values in (('position', position), ('rpy_deg', rpy)):
                if len(values) != 3:
                    raise InputError(f'{name}.{field}: must be three numbers, got {list(values)}')
            x, y, z = map(float, position)
            roll, pitch, yaw = map(math.radians, rpy)
            mounts.append(CameraMount(name, (x, y, z), (roll, pitch, yaw)))
        return mounts


def _check_number(name: str, value: Any) -> None:
    _, least, most, _ = _NUMBERS[name]
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and least <= value <= most):
        raise InputError(
            f'{name}: must be a number from {least:g} to {most:g}, got {shown(value)}'
        )

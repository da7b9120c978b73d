"""The parameters of `flexx2_camera`: those of the vendor's driver and additional ones."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
import math
from typing import Any

from flexx2_sim_ros.effects.effect import check_maps
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.messages.camera_info import is_rectified
from flexx2_sim_ros.nodes.effect_parameters import EffectParameters
from flexx2_sim_ros.nodes.parameters import declare
from flexx2_sim_ros.physics.frame_state import check_frequencies
from flexx2_sim_ros.processing import Chain, load_chain
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode, Profile
from rcl_interfaces.msg import (
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

_USECASE = 'usecase'
_AUTO = 'auto_exposure_0'
_EXPOSURE = 'exposure_time_0'
# Names that go into every message.
_LONGEST_FRAME_ID = 255
_CHOICES = {
    'invalid_value': ('nan', 'zero'),
    'input_depth': ('planar', 'radial'),
    'input_lens': ('auto', 'raw', 'rectified'),
    'cloud_layout': ('organised', 'driver'),
}


class CameraParameters:
    """
    Declare, check and hold the parameters of a camera node.

    ``profile`` gives modes and default intrinsics. ``on_change`` is called after a change of the
    mode or the effects, with whether the mode has changed. Raises InputError when a value given at
    the start cannot be used.

    Attributes
    ----------
    parent_frame : str
        Frame that the camera is mounted on; empty if it was not given.
    mount_position, mount_rpy : list of float
        Pose of the lens in that frame: metres; roll, pitch, yaw in radians.
    chain : Chain or None
        How depth is processed for ``~/processed/depth_image``, if it is.

    """

    def __init__(self, node: Node, profile: Profile, on_change: Callable[[bool], None]) -> None:
        """Declare all parameters; values given on the command line apply."""
        self._node = node
        self._profile = profile
        mode = self._declare_mode()
        self.effects = EffectParameters(node)
        self.serial: str = self._declare(
            'serial', 'SIM-0000', "The camera's serial number.", read_only=True
        )
        automatic = self._declare(
            _AUTO, True, 'Choose the exposure (of the gray image) automatically.'
        )
        node.declare_parameter(_EXPOSURE, mode.exposure_us[1], self._exposure_descriptor())
        if automatic:
            node.set_parameters([Parameter(_EXPOSURE, value=mode.exposure_us[1])])
        self.seed: int = self._declare('seed', 0, 'Seed of the noise.', read_only=True)
        self.camera_name = (
            self._declare(
                'camera_name',
                '',
                "Cameras of different names share no noise; empty: the node's full name.",
                read_only=True,
            )
            or node.get_fully_qualified_name()
        )
        self._declare_frame_id()
        self._declare_mount()
        self._check('frame_id', self.frame_id)
        self._declare_formats()
        self.intrinsics = self._declare_intrinsics(profile.intrinsics)
        check_maps(self.effects.chosen, self.intrinsics.width, self.intrinsics.height)
        self.chain = self._declare_chain()
        for name in _CHOICES:
            self._check(name, node.get_parameter(name).value)
        self._on_change = on_change
        node.add_pre_set_parameters_callback(self._canonical)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    def _declare_mode(self) -> Mode:
        node, profile = self._node, self._profile
        given = self._declare(
            _USECASE,
            profile.default_usecase,
            "The camera's mode; one of available_usecases. Settable while streaming.",
        )
        mode = profile.mode(given)
        if given != mode.name:
            node.set_parameters([Parameter(_USECASE, value=mode.name)])
        self.usecase = mode.name
        self._declare(
            'available_usecases',
            profile.names,
            "The camera's modes.",
            read_only=True,
            ignore_override=True,
        )
        self._declare(
            'model', profile.model, "The camera's model.", read_only=True, ignore_override=True
        )
        return mode

    def _declare_frame_id(self) -> None:
        self._declare(
            'frame_id',
            '',
            'frame_id of what is published; empty: that of the input, or '
            '<node>_optical_frame where parent_frame is set.',
        )

    def _declare_formats(self) -> None:
        self._declare('invalid_value', 'nan', 'How an invalid pixel is written: nan or zero.')
        self._declare(
            'input_depth',
            'planar',
            'What the input holds: planar (along the optical axis) or radial (along the ray).',
        )
        self._declare(
            'input_lens',
            'auto',
            'Whose pixels the input has: raw (K and distortion of its camera info), '
            'rectified (P), or auto (rectified for a topic image_rect).',
        )
        self._declare(
            'cloud_layout',
            'organised',
            "Size of the point cloud: organised (the image's "
            "width and height) or driver (exchanged, as the vendor's driver has them).",
        )

    @property
    def frame_id(self) -> str:
        """Return the frame to publish in; empty to take the frame of the input."""
        usual = f'{self._node.get_name()}_optical_frame' if self.parent_frame else ''
        return str(self._node.get_parameter('frame_id').value) or usual

    @property
    def radial(self) -> bool:
        """Return whether the input contains distances along the ray."""
        return bool(self._node.get_parameter('input_depth').value == 'radial')

    def is_rectified(self, topic: str) -> bool:
        """Return whether the images of a topic are rectified."""
        lens = self._node.get_parameter('input_lens').value
        return is_rectified(topic) if lens == 'auto' else bool(lens == 'rectified')

    @property
    def invalid_is_zero(self) -> bool:
        """Return whether an invalid pixel is written as 0 instead of NaN."""
        return bool(self._node.get_parameter('invalid_value').value == 'zero')

    @property
    def cloud_is_swapped(self) -> bool:
        """Return whether width and height of the point cloud are exchanged."""
        return bool(self._node.get_parameter('cloud_layout').value == 'driver')

    @property
    def exposure_share(self) -> float | None:
        """Return the exposure as a fraction of the mode's longest; None for automatic."""
        if self._node.get_parameter(_AUTO).value:
            return None
        longest = self._profile.mode(self.usecase).exposure_us[1]
        return float(self._node.get_parameter(_EXPOSURE).value) / longest

    def _declare(self, name: str, default: Any, description: str, **options: bool) -> Any:
        return declare(self._node, name, default, description, **options)

    def _declare_mount(self) -> None:
        self.parent_frame: str = self._declare(
            'parent_frame',
            '',
            'Frame that the camera is mounted on: its optical frame is '
            'published on /tf_static; empty: it is not.',
            read_only=True,
        )
        self.mount_position, degrees = (
            self._declare(f'mount.{name}', [0.0, 0.0, 0.0], text, read_only=True)
            for name, text in (
                ('position', 'Lens in parent_frame, metres.'),
                (
                    'rpy_deg',
                    'Roll, pitch (down), yaw (left) in degrees; zero looks along the x '
                    'axis of parent_frame, upright.',
                ),
            )
        )
        for name, values in (('position', self.mount_position), ('rpy_deg', degrees)):
            if len(values) != 3 or not all(map(math.isfinite, values)):
                raise InputError(
                    f'mount.{name}: must be three finite numbers, got {str(values)[:80]}'
                )
        self.mount_rpy = [math.radians(angle) for angle in degrees]

    def _declare_intrinsics(self, default: Intrinsics) -> Intrinsics:
        text = 'Intrinsics of the simulated camera, pixels'
        fx, fy, cx, cy = (
            self._declare(name, getattr(default, name), f'{text}: {name}.', read_only=True)
            for name in ('fx', 'fy', 'cx', 'cy')
        )
        distortion = self._declare(
            'distortion',
            list(default.distortion),
            'Distortion k1, k2, p1, p2, k3, or these and k4, k5, k6 of a rational lens.',
            read_only=True,
        )
        return Intrinsics(default.width, default.height, fx, fy, cx, cy, tuple(distortion))

    def _declare_chain(self) -> Chain | None:
        path = self._declare(
            'process',
            '',
            'YAML file of stages that make ~/processed/depth_image of the depth.',
            read_only=True,
        )
        if not path:
            return None
        try:
            chain = load_chain(path)
            chain.lens(self.intrinsics)  # complains
        except InputError as error:
            raise InputError(f'process: {error}') from error
        return chain

    def _exposure_descriptor(self) -> ParameterDescriptor:
        shortest, longest = self._profile.mode(self.usecase).exposure_us
        return ParameterDescriptor(
            type=ParameterType.PARAMETER_INTEGER,
            description='Exposure time, microseconds; its range changes with the mode.',
            additional_constraints=f'Has no effect while {_AUTO} is true.',
            integer_range=[IntegerRange(from_value=shortest, to_value=longest, step=1)],
        )

    @contextmanager
    def exposure_of_any_mode(self) -> Iterator[None]:
        """
        Let rclpy accept any exposure time inside the block.

        rclpy checks it against the range of the present mode. If the mode changes in the same
        request, mode and exposure are checked together here.
        """
        self._node.set_descriptor(
            _EXPOSURE, ParameterDescriptor(type=ParameterType.PARAMETER_INTEGER)
        )
        try:
            yield
        finally:
            self._node.set_descriptor(_EXPOSURE, self._exposure_descriptor())

    def _canonical(self, parameters: list[Parameter]) -> list[Parameter]:
        # The driver's spelling is stored and reported, not the user's.
        result = []
        for parameter in parameters:
            if parameter.name == _USECASE:
                with suppress(InputError):  # `_validate` returns the reason.
                    name = self._profile.mode(parameter.value).name
                    parameter = Parameter(_USECASE, value=name)
            result.append(parameter)
        return self.effects.expand(self._with_exposure(result))

    def _with_exposure(self, parameters: list[Parameter]) -> list[Parameter]:
        # Like the driver: a new mode starts at its longest exposure. An automatic
        # exposure, which is the longest here, cannot be set.
        values = {parameter.name: parameter.value for parameter in parameters}
        mode = self._mode_of(values)
        if mode is None or not values.keys() & {_USECASE, _AUTO, _EXPOSURE}:
            return parameters
        shortest, longest = mode.exposure_us
        given = values.get(_EXPOSURE, longest)
        automatic = values.get(_AUTO, self._node.get_parameter(_AUTO).value)
        reset = mode.name != self.usecase and _EXPOSURE not in values
        if not (reset or automatic is True) or type(given) is not int:
            return parameters
        if not shortest <= given <= longest:
            return parameters  # Refused, automatic or not.
        return [
            *(parameter for parameter in parameters if parameter.name != _EXPOSURE),
            Parameter(_EXPOSURE, value=longest),
        ]

    def _mode_of(self, values: Mapping[str, Any]) -> Mode | None:
        # The mode after the change; None if there is no such mode.
        with suppress(InputError):
            return self._profile.mode(values.get(_USECASE, self.usecase))
        return None

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        values = {parameter.name: parameter.value for parameter in parameters}
        try:
            for name, value in values.items():
                self._check(name, value)
            mode = self._profile.mode(values.get(_USECASE, self.usecase))
            shortest, longest = mode.exposure_us
            if not shortest <= values.get(_EXPOSURE, longest) <= longest:
                raise InputError(
                    f'{_EXPOSURE}: must be {shortest} to {longest} in {mode.name}, '
                    f'got {values[_EXPOSURE]}'
                )
            effects = self.effects.check(values)
            check_frequencies(effects, mode)
            check_maps(effects, self.intrinsics.width, self.intrinsics.height)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check(self, name: str, value: Any) -> None:
        if name in _CHOICES and value not in _CHOICES[name]:
            raise InputError(
                f'{name}: must be one of {", ".join(_CHOICES[name])}, got {shown(value)}'
            )
        if name == 'frame_id' and len(value) > _LONGEST_FRAME_ID:
            raise InputError(
                f'{name}: must be at most {_LONGEST_FRAME_ID} characters, got {len(value)}'
            )

    def _apply(self, parameters: list[Parameter]) -> None:
        values = {parameter.name: parameter.value for parameter in parameters}
        new_effects = self.effects.apply(values)
        before, self.usecase = self.usecase, values.get(_USECASE, self.usecase)
        if new_effects or self.usecase != before:
            self._on_change(self.usecase != before)

"""The parameters of `flexx2_camera`: the vendor driver's, and this camera's own."""

from collections.abc import Callable
from typing import Any

from flexx2_sim_ros.camera.intrinsics import Intrinsics
from flexx2_sim_ros.camera.modes import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.effect_parameters import EffectParameters
from flexx2_sim_ros.nodes.parameters import declare
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
_CHOICES = {'invalid_value': ('nan', 'zero'), 'input_depth': ('planar', 'radial')}


class CameraParameters:
    """
    Declare, check and hold the parameters of a camera node.

    Parameters
    ----------
    node : rclpy.node.Node
        The node to declare them on.
    profile : Profile
        The camera; gives modes and default intrinsics.
    on_new_mode : callable
        Called after ``usecase`` has changed to another mode.
    on_new_effects : callable
        Called after effects have changed.

    Raises
    ------
    InputError
        When a value given at the start cannot be used.

    """

    def __init__(self, node: Node, profile: Profile, on_new_mode: Callable[[], None],
                 on_new_effects: Callable[[], None]) -> None:
        """Declare all parameters; values given on the command line apply."""
        self._node = node
        self._profile = profile
        self._switching = False
        declare = self._declare
        given = declare(_USECASE, profile.default_usecase, "The camera's mode; one of "
                        'available_usecases. Settable while streaming.')
        mode = profile.mode(given)
        if given != mode.name:
            node.set_parameters([Parameter(_USECASE, value=mode.name)])
        self.usecase = mode.name
        self.effects = EffectParameters(
            node, lambda: bool(self._profile.mode(self.usecase).modulation_hz), on_new_effects)
        declare('available_usecases', profile.names, "The camera's modes.", read_only=True,
                ignore_override=True)
        declare('model', profile.model, "The camera's model.", read_only=True,
                ignore_override=True)
        # A serial made of digits arrives as a number.
        self.serial = str(declare('serial', 'SIM-0000', "The camera's serial number.",
                                  read_only=True, any_type=True))
        declare(_AUTO, True, 'Choose the exposure (of the gray image) automatically.')
        node.declare_parameter(_EXPOSURE, mode.exposure_us[1], self._exposure_descriptor())
        self.seed: int = declare('seed', 0, 'Seed of the noise.', read_only=True)
        self.camera_name: str = declare(
            'camera_name', '', "Cameras of different names share no noise; empty: the node's "
            'full name.', read_only=True) or node.get_fully_qualified_name()
        declare('frame_id', '', 'frame_id of what is published; empty: that of the input.')
        declare('invalid_value', 'nan', 'How an invalid pixel is written: nan or zero.',
                any_type=True)
        declare('input_depth', 'planar', 'What the input holds: planar (along the optical axis) '
                'or radial (along the ray).')
        self.intrinsics = self._declare_intrinsics(profile.intrinsics)
        for parameter in self._canonical([node.get_parameter(name) for name in _CHOICES]):
            self._check(parameter.name, parameter.value)
            node.set_parameters([parameter])
        self._on_new_mode = on_new_mode
        node.add_pre_set_parameters_callback(self._canonical)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    @property
    def frame_id(self) -> str:
        """Return the frame to publish in; empty for the input's."""
        return str(self._node.get_parameter('frame_id').value)

    @property
    def radial(self) -> bool:
        """Say whether the input holds distances along the ray."""
        return bool(self._node.get_parameter('input_depth').value == 'radial')

    @property
    def invalid_is_zero(self) -> bool:
        """Say whether an invalid pixel is written as 0 instead of NaN."""
        return bool(self._node.get_parameter('invalid_value').value == 'zero')

    @property
    def exposure_share(self) -> float | None:
        """Return exposure as a share of the mode's longest; None for automatic."""
        if self._node.get_parameter(_AUTO).value:
            return None
        longest = self._profile.mode(self.usecase).exposure_us[1]
        return float(self._node.get_parameter(_EXPOSURE).value) / longest

    def _declare(self, name: str, default: Any, description: str, **options: bool) -> Any:
        return declare(self._node, name, default, description, **options)

    def _declare_intrinsics(self, default: Intrinsics) -> Intrinsics:
        text = 'Intrinsics of the simulated camera, pixels'
        fx, fy, cx, cy = (self._declare(name, getattr(default, name), f'{text}: {name}.',
                                        read_only=True)
                          for name in ('fx', 'fy', 'cx', 'cy'))
        distortion = self._declare('distortion', list(default.distortion),
                                   'plumb_bob distortion k1, k2, p1, p2, k3.', read_only=True)
        return Intrinsics(default.width, default.height, fx, fy, cx, cy, tuple(distortion))

    def _exposure_descriptor(self) -> ParameterDescriptor:
        shortest, longest = self._profile.mode(self.usecase).exposure_us
        return ParameterDescriptor(
            type=ParameterType.PARAMETER_INTEGER,
            description='Exposure time, microseconds; its range changes with the mode.',
            additional_constraints=f'Cannot be set while {_AUTO} is true.',
            integer_range=[IntegerRange(from_value=shortest, to_value=longest, step=1)])

    def _canonical(self, parameters: list[Parameter]) -> list[Parameter]:
        # What is stored and reported is the driver's spelling, whatever was typed.
        result = []
        for parameter in parameters:
            if parameter.name == _USECASE:
                try:
                    name = self._profile.mode(parameter.value).name
                    parameter = Parameter(_USECASE, value=name)
                except InputError:
                    pass
            if parameter.name == 'invalid_value' and parameter.value != parameter.value:
                # `-p invalid_value:=nan` arrives as the number.
                parameter = Parameter('invalid_value', value='nan')
            result.append(parameter)
        return self.effects.expand(result)

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                self._check(parameter.name, parameter.value)
            automatic = {p.name: p.value for p in parameters}.get(
                _AUTO, self._node.get_parameter(_AUTO).value)
            if (any(p.name == _EXPOSURE for p in parameters) and automatic
                    and not self._switching):
                raise InputError(f'{_EXPOSURE}: cannot be set while {_AUTO} is true; set {_AUTO} '
                                 'to false first')
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check(self, name: str, value: Any) -> None:
        if name == _USECASE and not self._profile.mode(value).modulation_hz and self.effects.on:
            raise InputError(f'{name}: modulation_hz of {value} is not known in the camera '
                             'profile, wanted the frequencies, since effects are on')
        if name in _CHOICES and value not in _CHOICES[name]:
            raise InputError(f'{name}: found {value!r}, wanted one of '
                             f'{", ".join(_CHOICES[name])}')

    def _apply(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == _USECASE and parameter.value != self.usecase:
                self.usecase = parameter.value
                self._reset_exposure()
                self._on_new_mode()

    def _reset_exposure(self) -> None:
        # As the driver does: another mode has another range and starts at its longest exposure.
        # A range without limits lets the value change before the new range is in place.
        self._switching = True
        try:
            longest = self._profile.mode(self.usecase).exposure_us[1]
            self._node.set_descriptor(
                _EXPOSURE, ParameterDescriptor(type=ParameterType.PARAMETER_INTEGER))
            self._node.set_parameters([Parameter(_EXPOSURE, value=longest)])
            self._node.set_descriptor(_EXPOSURE, self._exposure_descriptor())
        finally:
            self._switching = False

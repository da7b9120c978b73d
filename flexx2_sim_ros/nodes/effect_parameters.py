"""The parameters of `flexx2_camera` that switch effects: a file, and each number by itself."""

from collections.abc import Callable, Iterable
from contextlib import suppress

from flexx2_sim_ros.effects import Effect, load_effects, registry
from flexx2_sim_ros.effects import Parameter as EffectParameter
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.parameters import declare
from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

_FILE = 'effects'


class EffectParameters:
    """
    Declare, check and hold ``effects`` and ``effect.<name>.<parameter>``.

    ``effects`` is the path of a YAML file (or a preset's name). Setting it sets all the others:
    to what the file says, and off where it says nothing.

    Parameters
    ----------
    node : rclpy.node.Node
        The node to declare them on.
    allowed : callable
        Says whether the camera's present mode can have effects at all.
    on_change : callable
        Called after any of them has changed.

    Attributes
    ----------
    chosen : tuple of Effect
        All effects with their present parameters; those of strength 0 are off.

    Raises
    ------
    InputError
        When a value given at the start cannot be used.

    """

    def __init__(self, node: Node, allowed: Callable[[], bool],
                 on_change: Callable[[], None]) -> None:
        """Declare all; the file first, then what is given beside it."""
        self._node = node
        self._allowed = allowed
        self._items = {f'effect.{kind.name}.{item.name}': item
                       for kind in registry().values() for item in kind.parameters()}
        path = declare(node, _FILE, '', 'Effects beyond the noise model: path of a YAML file, or '
                       'the name of a preset, e.g. typical; empty: none. Sets all effect.* '
                       'parameters.')
        for name, value in _values(path).items():
            self._declare(name, value)
        self._others = _others(path)
        self.chosen = (*self._build({}), *self._others)
        self._on_change = on_change
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    @property
    def on(self) -> bool:
        """Whether any effect is on."""
        return any(effect.strength for effect in self.chosen)

    def expand(self, parameters: list[Parameter]) -> list[Parameter]:
        """Return what is to be set: whole numbers as floats, and all that a file says."""
        given = [self._as_float(parameter) for parameter in parameters]
        names = {parameter.name for parameter in given}
        extra: dict[str, float] = {}
        for parameter in given:
            if parameter.name == _FILE and isinstance(parameter.value, str):
                with suppress(InputError):  # `_validate` says why.
                    extra = _values(parameter.value)
        return [*(Parameter(name, value=value) for name, value in extra.items()
                  if name not in names), *given]

    def _as_float(self, parameter: Parameter) -> Parameter:
        if parameter.name in self._items and parameter.type_ == Parameter.Type.INTEGER:
            return Parameter(parameter.name, value=float(parameter.value))
        return parameter

    def _declare(self, name: str, default: float) -> None:
        item = self._items[name]
        text = f'{item.text}, {item.unit}' if item.unit else item.text
        # Of any type at first, since -p effect.offset.strength:=1 is a whole number.
        given = self._node.declare_parameter(
            name, default, ParameterDescriptor(dynamic_typing=True)).value
        value = item.checked(given, name)
        if not isinstance(given, float):
            self._node.set_parameters([Parameter(name, value=value)])
        self._node.set_descriptor(name, ParameterDescriptor(
            type=ParameterType.PARAMETER_DOUBLE, description=text,
            floating_point_range=[FloatingPointRange(from_value=item.low, to_value=item.high)]))

    def _build(self, changed: dict[str, float]) -> tuple[Effect, ...]:
        effects = []
        for kind in registry().values():
            names = {item.name: f'effect.{kind.name}.{item.name}' for item in kind.parameters()}
            effects.append(kind(**{
                short: changed[name] if name in changed else self._node.get_parameter(name).value
                for short, name in names.items()}))
        return tuple(effects)

    def _validate(self, parameters: Iterable[Parameter]) -> SetParametersResult:
        try:
            changed, others = {}, self._others
            for parameter in parameters:
                if parameter.name == _FILE:
                    others = _others(parameter.value)
                if parameter.name in self._items:
                    changed[parameter.name] = self._items[parameter.name].checked(
                        parameter.value, parameter.name)
            if changed and not self._allowed() and any(
                    effect.strength for effect in (*self._build(changed), *others)):
                raise InputError('effect: modulation_hz of the mode is not known in the camera '
                                 'profile, wanted the frequencies, which effects work on')
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Iterable[Parameter]) -> None:
        files = [parameter.value for parameter in parameters if parameter.name == _FILE]
        if files:
            self._others = _others(files[-1])
        if files or any(parameter.name in self._items for parameter in parameters):
            chosen = (*self._build({}), *self._others)
            if chosen != self.chosen:
                self.chosen = chosen
                self._on_change()


def _others(path: str) -> tuple[Effect, ...]:
    # What a file has besides the registry's: it comes and goes with the file.
    return tuple(effect for effect in (load_effects(path) if path else ())
                 if effect.name not in registry())


def _values(path: str) -> dict[str, float]:
    # All effect.* parameters as a file sets them; none is on without one.
    loaded = {effect.name: effect for effect in (load_effects(path) if path else ())}

    def value(kind: type[Effect], item: EffectParameter) -> float:
        if kind.name in loaded:
            return float(getattr(loaded[kind.name], item.name))
        return 0.0 if item.name == 'strength' else item.default

    return {f'effect.{kind.name}.{item.name}': value(kind, item)
            for kind in registry().values() for item in kind.parameters()}

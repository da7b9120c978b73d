"""The parameters of `flexx2_camera` for effects: a file, and each number of each effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects import Effect, load_effects, registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.parameters import declare
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter

FILE = 'effects'
# Suffix of the file's name when the camera's numbers differ from the file's.
_CHANGED = '*'
_NO_FILE = 'none'  # before it: a file of parameters does not keep '*' alone


@dataclass(frozen=True)
class _Source:
    # The content of a file: the value of every effect.* parameter (strength 0 for effects that it
    # does not name), the curves and maps of effects, and the effects without parameters. Only
    # the file sets the last two.
    name: str
    numbers: Mapping[str, float]
    forms: Mapping[str, Mapping[str, Any]]
    others: tuple[Effect, ...]


class EffectParameters:
    """
    Declare, check and hold ``effects`` and ``effect.<name>.<parameter>``.

    ``effects`` is the path of a YAML file (or a preset's name). Setting it sets all other
    parameters to the values in the file. Effects that the file does not name are switched off.
    Numbers in the same request have priority over the file. The value of ``effects`` ends with
    ``*`` while a number differs from the file's. Setting a value that ends with ``*`` does not
    change the numbers, so parameters can be saved and set again in any order.

    ``chosen`` are all effects with their present parameters; those of strength 0 are off. Raises
    InputError when a value given at the start cannot be used.
    """

    def __init__(self, node: Node) -> None:
        """Declare all parameters: the file first, then the single numbers."""
        self._node = node
        self._items = {
            f'effect.{kind.name}.{item.name}': item
            for kind in registry().values()
            for item in kind.parameters()
        }
        text = declare(
            node,
            FILE,
            '',
            'Effects beyond the noise model: path of a YAML file, or '
            'the name of a preset, e.g. typical; empty: none. Sets all effect.* '
            'parameters. Ends with * while one of them differs from the file; setting '
            'a name with * leaves them as they are.',
        )
        self._source = _read(text.removesuffix(_CHANGED))
        start = _read('') if text.endswith(_CHANGED) else self._source
        # What `expand` read for the present request, or its error.
        self._next: _Source | InputError = self._source
        for name, value in start.numbers.items():
            self._declare(name, value)
        node.set_parameters([Parameter(FILE, value=self._text(self._source, self._numbers()))])
        self.chosen = self._build(self._numbers(), self._source)

    def expand(self, parameters: Sequence[Parameter]) -> list[Parameter]:
        """Return the parameters to set: whole numbers as floats, and all numbers of a file."""
        given = [self._as_float(parameter) for parameter in parameters]
        numbers = {p.name: p.value for p in given if p.name in self._items}
        texts = [p.value for p in given if p.name == FILE]
        if not (numbers or texts):
            return given
        self._next, loaded = self._source, dict[str, float]()
        if texts:
            if not isinstance(texts[-1], str):
                return given  # The type check refuses it.
            try:
                self._next = _read(texts[-1].removesuffix(_CHANGED))
            except InputError as error:
                self._next = error
                return given  # `check` raises the reason.
            if not texts[-1].endswith(_CHANGED):
                loaded = {
                    name: value
                    for name, value in self._next.numbers.items()
                    if name not in numbers
                }
        text = self._text(self._next, {**self._numbers(), **loaded, **numbers})
        return [
            *(p for p in given if p.name != FILE),
            *(Parameter(name, value=value) for name, value in loaded.items()),
            Parameter(FILE, value=text),
        ]

    def check(self, values: Mapping[str, Any]) -> tuple[Effect, ...]:
        """
        Check new values by name; return all effects with these values.

        Raises InputError when a value or the file cannot be used.
        """
        if FILE in values and isinstance(self._next, InputError):
            raise self._next
        changed = {
            name: self._items[name].checked(value, name)
            for name, value in values.items()
            if name in self._items
        }
        return self._after(values, changed)

    def apply(self, values: Mapping[str, Any]) -> bool:
        """Apply new values by name; return whether the effects have changed."""
        before = self.chosen
        self.chosen = self._after(values, {})
        if FILE in values and isinstance(self._next, _Source):
            self._source = self._next
        return self.chosen != before

    def _after(
        self, values: Mapping[str, Any], changed: Mapping[str, float]
    ) -> tuple[Effect, ...]:
        source = self._source
        if FILE in values and isinstance(self._next, _Source):
            source = self._next
        return self._build({**self._numbers(), **changed}, source)

    def _text(self, source: _Source, numbers: Mapping[str, Any]) -> str:
        if numbers == source.numbers:
            return source.name
        return (source.name or _NO_FILE) + _CHANGED

    def _numbers(self) -> dict[str, float]:
        return {name: self._node.get_parameter(name).value for name in self._items}

    def _as_float(self, parameter: Parameter) -> Parameter:
        if parameter.name in self._items and parameter.type_ == Parameter.Type.INTEGER:
            return Parameter(parameter.name, value=float(parameter.value))
        return parameter

    def _declare(self, name: str, default: float) -> None:
        item = self._items[name]
        text = f'{item.text}, {item.unit}' if item.unit else item.text
        # Declared with any type, because -p effect.offset.strength:=1 is a whole number.
        given = self._node.declare_parameter(
            name, default, ParameterDescriptor(dynamic_typing=True)
        ).value
        value = item.checked(given, name)
        if not isinstance(given, float):
            self._node.set_parameters([Parameter(name, value=value)])
        self._node.set_descriptor(
            name,
            ParameterDescriptor(
                type=ParameterType.PARAMETER_DOUBLE,
                description=text,
                floating_point_range=[FloatingPointRange(from_value=item.low, to_value=item.high)],
            ),
        )

    def _build(self, numbers: Mapping[str, float], source: _Source) -> tuple[Effect, ...]:
        own = (
            kind(
                **{
                    item.name: numbers[f'effect.{kind.name}.{item.name}']
                    for item in kind.parameters()
                },
                **source.forms.get(kind.name, {}),
            )
            for kind in registry().values()
        )
        return (*own, *source.others)


def _read(name: str) -> _Source:
    name = '' if name == _NO_FILE else name
    try:
        effects = load_effects(name) if name else ()
    except InputError as error:
        raise InputError(f'{FILE}: {error}') from error
    loaded = {effect.name: effect for effect in effects}
    numbers = {}
    for kind in registry().values():
        for item in kind.parameters():
            off = 0.0 if item.name == 'strength' else item.default
            value = getattr(loaded[kind.name], item.name) if kind.name in loaded else off
            numbers[f'effect.{kind.name}.{item.name}'] = float(value)
    return _Source(
        name,
        numbers,
        {name: effect.forms for name, effect in loaded.items()},
        tuple(effect for effect in effects if effect.name not in registry()),
    )

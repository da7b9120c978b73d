"""What an effect is: a dataclass of parameters with one function."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
import math
from typing import Any, ClassVar

from flexx2_sim_ros.camera.exposure import Exposure, Stage
from flexx2_sim_ros.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of an effect.

    Attributes
    ----------
    name, text, unit : str
        For people; unit is empty for a plain number.
    default, low, high : float
        Typical value and bounds.

    """

    name: str
    text: str
    unit: str
    default: float
    low: float
    high: float


def parameter(default: float, low: float, high: float, unit: str, text: str) -> Any:
    """Declare a parameter of an effect: a dataclass field with bounds, unit and description."""
    return field(default=default, metadata={'low': low, 'high': high, 'unit': unit, 'text': text})


@dataclass(frozen=True)
class Effect:
    """
    Base of all effects.

    A subclass is a frozen dataclass whose fields are made by `parameter`, with the class
    attributes below and `apply`. Defining it in a module of this package registers it.

    Attributes
    ----------
    name : str
        Identifier, as in files and parameters.
    stage : Stage
        Where in the order of light it acts.
    order : int
        Within the stage; lower first.
    title : str
        What it is and what it does to the data, in one line.
    covariate : str
        What its signature depends on: ``distance``, ``incidence``, ``amplitude``, ``image``,
        ``edge``, ``time`` or ``none``.
    source : str
        Where model and typical values come from.
    keeps : bool
        Whether it remembers something between frames.
    strength : float
        0 is off, 1 typical.

    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    order: ClassVar[int] = 0
    title: ClassVar[str]
    covariate: ClassVar[str]
    source: ClassVar[str]
    keeps: ClassVar[bool] = False

    strength: float = parameter(1.0, 0.0, 4.0, '', '0 is off, 1 is typical')

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        for item in self.parameters():
            value = getattr(self, item.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
                    math.isfinite(value) and item.low <= value <= item.high):
                raise InputError(
                    f'{self.name}.{item.name}: found {value!r}, wanted a number from {item.low:g} '
                    f'to {item.high:g}{f" {item.unit}" if item.unit else ""}')

    @classmethod
    def parameters(cls) -> list[Parameter]:
        """Return the effect's parameters, strength first."""
        return [Parameter(f.name, f.metadata['text'], f.metadata['unit'],
                          float(f.default),  # type: ignore[arg-type]
                          f.metadata['low'], f.metadata['high']) for f in fields(cls)]

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any] | None) -> 'Effect':
        """
        Build from names and numbers, as in a YAML file.

        Raises
        ------
        InputError
            For an unknown name or a value out of bounds.

        """
        values = {} if values is None else values
        if not isinstance(values, Mapping):
            raise InputError(f'{cls.name}: found {values!r}, wanted a table of parameters')
        known = [item.name for item in cls.parameters()]
        for name in values:
            if name not in known:
                raise InputError(f'{cls.name}.{name}: no such parameter, wanted one of '
                                 f'{", ".join(known)}')
        return cls(**values)

    def apply(self, exposure: Exposure) -> None:
        """Change the frame in the making."""
        raise NotImplementedError

"""What an effect is: a dataclass of parameters with one function."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np

# What can be measured of a still scene, away from its edges but for `edges`: mean depth, its
# standard deviation over frames, the share of gross outliers, correlation from frame to frame and
# from pixel to pixel, where there is depth at all, amplitude, and what is seen at depth jumps.
CHANNELS = ('bias', 'noise', 'outliers', 'frames', 'neighbours', 'validity', 'amplitude', 'edges')


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

    def checked(self, value: Any, where: str) -> float:
        """
        Return a value as a float.

        Raises
        ------
        InputError
            When it is no number or out of bounds; names `where`, the parameter's full name.

        """
        if (
            isinstance(value, int | float | np.integer | np.floating)
            and not isinstance(value, bool)
            and self.low <= value <= self.high
        ):  # never true of NaN
            return float(value)
        unit = f' {self.unit}' if self.unit else ''
        raise InputError(
            f'{where}: found {shown(value)}, wanted a number from {self.low:g} to '
            f'{self.high:g}{unit}'
        )


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
    changes : tuple of str
        The channels in which a still scene shows it, out of `CHANNELS`.
    typical : bool
        Whether a typical camera, well placed and calibrated, shows it.
    source : str
        Where model and typical values come from.
    keeps : bool
        Whether it remembers something between frames.
    needs_modulation : bool
        Whether it works on phases, for which the modulation frequencies must be known.
    listed : bool
        Whether it is in the registry; otherwise files alone can name it.
    strength : float
        0 is off, 1 typical.

    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    order: ClassVar[int] = 0
    title: ClassVar[str]
    covariate: ClassVar[str]
    changes: ClassVar[tuple[str, ...]]
    typical: ClassVar[bool] = False
    source: ClassVar[str]
    keeps: ClassVar[bool] = False
    needs_modulation: ClassVar[bool] = False
    listed: ClassVar[bool] = True

    strength: float = parameter(1.0, 0.0, 4.0, '', '0 is off, 1 is typical')

    def __post_init__(self) -> None:
        """Refuse what is no number or out of bounds; make all of them floats."""
        for item in self.parameters():
            value = item.checked(getattr(self, item.name), f'{self.name}.{item.name}')
            object.__setattr__(self, item.name, value)

    @classmethod
    def parameters(cls) -> list[Parameter]:
        """Return the effect's parameters, strength first."""
        return [
            Parameter(
                f.name,
                f.metadata['text'],
                f.metadata['unit'],
                float(f.default),  # type: ignore[arg-type]
                f.metadata['low'],
                f.metadata['high'],
            )
            for f in fields(cls)
        ]

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
            raise InputError(f'{cls.name}: found {shown(values)}, wanted a table of parameters')
        known = [item.name for item in cls.parameters()]
        for name in values:
            if name not in known:
                raise InputError(
                    f'{cls.name}.{unquoted(name)}: no such parameter, wanted one of '
                    f'{", ".join(known)}'
                )
        return cls(**values)

    def apply(self, state: FrameState) -> None:
        """Change the frame in the making."""
        raise NotImplementedError

"""Which parameters of an effect a calibration fits, as plain data."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Free:
    """
    A parameter or optional number `name` that is fitted between `low` and `high`.

    With ``log``, steps are factors and not differences.
    """

    name: str
    low: float
    high: float
    log: bool = False


@dataclass(frozen=True)
class Shape:
    """
    Parameters that are fitted together; the strength is 1.

    Attributes
    ----------
    label : str
        For people.
    free : tuple of Free
        What is fitted.
    fixed : mapping
        Other parameters of the effect that this shape sets.
    quick : bool
        Whether a diagnosis searches for it already, from what it found and with few simulations.

    """

    label: str
    free: tuple[Free, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    quick: bool = False


@dataclass(frozen=True)
class Scale:
    """
    A parameter that the shift of surfaces is proportional to, where poses hide most of the shift.

    It is fitted with the poses, from 0 to ``most``; the strength is 1. ``label`` is for people,
    ``name`` is the parameter's. ``variants`` are other parameters of the effect; the variant is
    taken that suits the recordings best.
    """

    label: str
    name: str
    most: float
    variants: tuple[Mapping[str, float], ...]

    def settings(self, value: float, variant: Mapping[str, float]) -> dict[str, float]:
        """Return the effect's settings."""
        return {'strength': 1.0, self.name: value, **variant}


MHZ = Free('mhz', 12.0, 130.0, log=True)

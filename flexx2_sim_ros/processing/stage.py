"""What a stage of processing says of itself."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.limits import is_finite
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np


def option(default: Any, low: float = 0, high: float = 0, choices: tuple[str, ...] = ()) -> Any:
    """Declare an option of a stage: a number with bounds, whole if the default is, or a choice."""
    return field(default=default, metadata={'low': low, 'high': high, 'choices': choices})


@dataclass(frozen=True)
class Stage:
    """
    Base of all stages: a frozen dataclass whose fields are made by `option`.

    Attributes
    ----------
    name : str
        As in files.
    leaves_out : bool
        Whether it leaves moments out, by their stamps alone.
    in_metres : bool
        Whether it gives metres, NaN where invalid.

    """

    name: ClassVar[str]
    leaves_out: ClassVar[bool] = False
    in_metres: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse options that cannot be used."""
        for one in fields(self):
            low, high, choices = (one.metadata[key] for key in ('low', 'high', 'choices'))
            value, where = getattr(self, one.name), f'{self.name}.{one.name}'
            if choices:
                if value not in choices:
                    raise InputError(
                        f'{where}: must be one of {", ".join(choices)}, got {shown(value)}'
                    )
                continue
            whole = isinstance(one.default, int)
            if not (is_finite(value) and low <= value <= high and (value % 1 == 0 or not whole)):
                kind = 'a whole number' if whole else 'a number'
                raise InputError(
                    f'{where}: must be {kind} from {low:g} to {high:g}, got {shown(value)}'
                )
            object.__setattr__(self, one.name, int(value) if whole else float(value))

    @classmethod
    def from_mapping(cls, options: Any) -> 'Stage':
        """
        Build from options by name, or none.

        Raises
        ------
        InputError
            For an unknown name or a value that cannot be used.

        """
        options = {} if options is None else options
        if not isinstance(options, Mapping):
            raise InputError(f'{cls.name}: must be a table of options, got {shown(options)}')
        known = [one.name for one in fields(cls)]
        for name in options:
            if name not in known:
                raise InputError(
                    f'{cls.name}.{unquoted(name)}: must be one of {", ".join(known)}, got an '
                    'unknown option'
                )
        return cls(**options)

    def lens(self, camera: Intrinsics) -> Intrinsics:
        """Return the lens of the images after this stage; an `InputError` if there are none."""
        return camera

    def picked(self, images: np.ndarray) -> np.ndarray:
        """Return other images, (..., H, W), at the pixels of this stage: the nearest ones."""
        return images

    def apply(self, images: np.ndarray, stamp: int, memory: dict[str, Any]) -> np.ndarray | None:
        """
        Process the images of one moment.

        Parameters
        ----------
        images : numpy.ndarray
            (..., H, W) float32, metres along the optical axis, NaN where invalid.
        stamp : int
            Nanoseconds.
        memory : dict
            What the stage keeps until the next moment. Arrays in it have the leading dimensions
            of the images.

        Returns
        -------
        numpy.ndarray or None
            None where this moment is left out.

        """
        raise NotImplementedError

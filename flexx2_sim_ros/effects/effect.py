"""What an effect is: a dataclass of parameters with one function."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
import hashlib
from typing import Any, ClassVar

from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis, Searched
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Scale, Shape
from flexx2_sim_ros.effects.tables import PixelMap, Table
from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np

# What can be measured of a still scene, away from its edges but for `edges`: mean depth, its
# standard deviation over frames, the fraction of gross outliers, correlation from frame to frame
# and from pixel to pixel, where there is depth at all, amplitude, and what is seen at depth jumps.
CHANNELS = ('bias', 'noise', 'outliers', 'frames', 'neighbours', 'validity', 'amplitude', 'edges')
COVARIATES = ('distance', 'incidence', 'amplitude', 'concavity', 'image', 'edge', 'time', 'none')
# What of a recording is known only roughly, and can hide an effect or look like it.
NUISANCES = ('pose', 'reflectivity', 'sigma', 'edges', 'uptime')
_OWN_STREAMS = 2**16  # those below are given by hand


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
            f'{where}: must be a number from {self.low:g} to {self.high:g}{unit}, got '
            f'{shown(value)}'
        )


def parameter(default: float, low: float, high: float, unit: str, text: str) -> Any:
    """Declare a parameter of an effect: a dataclass field with bounds, unit and description."""
    return field(default=default, metadata={'low': low, 'high': high, 'unit': unit, 'text': text})


@dataclass(frozen=True)
class Effect:
    """
    Base of all effects.

    A subclass is a frozen dataclass whose fields are made by `parameter`, `tables.curve_over`,
    `tables.pixel_map` or `tables.optional_number`, with the class attributes below and `apply`.
    It says all that there is to say about the effect: files, node parameters, documentation,
    pictures, the diagnosis and the benchmark follow from it.

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
        What its signature depends on, out of `COVARIATES`.
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
    stream : int
        Which random numbers are its own; derived from the name unless given. Never renumber.
    picture : Picture
        How it is drawn.
    batched : tuple of str or None
        Which memory and passes its formula needs in the kernels of `flexx2_sim_ros.batch`:
        ``pose``, ``view``, ``history``, ``edges``, ``footprint``, ``bounce``, ``scatter``,
        ``motion``, ``taps``, ``passing``, ``harmonics``, ``shift``, ``grain``, ``sigma``,
        ``tails``, ``neighbours``, ``measured``. None: it has no kernel, and `apply` runs for one
        environment after the other.
    hypotheses : tuple of Hypothesis
        The variants in which a diagnosis looks for it.
    shapes : tuple of Shape
        The parameters that a calibration fits, from simple to flexible: those of effects on
        geometry together with the poses, the others by simulation.
    scale : Scale or None
        The parameter that a calibration fits to the shift of surfaces, together with the poses.
    searched : Searched or None
        What of it a diagnosis finds from the recordings first, and the variants that follow.
    nuisances : tuple of str
        What can hide it or look like it, out of `NUISANCES`.
    family : str
        Which kind of function of the camera's internals is free in it.
    smooth : bool
        Whether it only shifts or loses pixels and adds neither noise nor grain, so that very few
        frames show it.
    needs_motion : bool
        Whether only moving scenes show it.
    filters : bool
        Whether it averages, so that the noise before it must have been larger.
    brightness : float
        By which fraction its size varies when reflectivity is 20 % wrong.
    like_a_pose : tuple of mapping
        Parameters with which it is put beside a pose error when a recording's pose is looked for,
        since it shifts whole surfaces, too.
    role : str
        Which of the diagnosis's own nuisances it is: ``bias``, ``sigma``, ``pose`` or none.
    repeats : bool
        Whether it leaves the same grain in every recording.
    lattice : str
        The parameter that is the step between depths, if depths come in steps.
    doubt : float
        Loss a recording that it has to earn beyond the usual, for errors that look like it.
    compared : str
        The parameter that the benchmark compares with the truth, if any.
    reads_as : tuple of (str, str)
        Channels and axes of a benchmark's baselines whose largest gap it is taken for.
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
    listed: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = False
    stream: ClassVar[int]
    picture: ClassVar[Picture] = Picture()
    batched: ClassVar[tuple[str, ...] | None] = None
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('strength', (0.5, 1.0, 2.0), 0.0, 4.0, few=False),
    )
    shapes: ClassVar[tuple[Shape, ...]] = ()
    scale: ClassVar[Scale | None] = None
    searched: ClassVar[Searched | None] = None
    nuisances: ClassVar[tuple[str, ...]] = ()
    family: ClassVar[str] = ''
    smooth: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    filters: ClassVar[bool] = False
    brightness: ClassVar[float] = 0.0
    like_a_pose: ClassVar[tuple[Mapping[str, float], ...]] = ()
    role: ClassVar[str] = ''
    repeats: ClassVar[bool] = False
    lattice: ClassVar[str] = ''
    doubt: ClassVar[float] = 0.0
    compared: ClassVar[str] = ''
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = ()

    strength: float = parameter(1.0, 0.0, 4.0, '', '0 is off, 1 is typical')

    def __init_subclass__(cls) -> None:
        """Give the effect random numbers of its own."""
        super().__init_subclass__()
        if 'name' in vars(cls) and 'stream' not in vars(cls):
            cls.stream = stream_of(cls.name)

    def __post_init__(self) -> None:
        """Refuse what is no number or out of bounds; make all of them floats."""
        for item in self.parameters():
            value = item.checked(getattr(self, item.name), f'{self.name}.{item.name}')
            object.__setattr__(self, item.name, value)
        for name, table in self.tables().items():
            one = table.checked(getattr(self, name), f'{self.name}.{name}')
            object.__setattr__(self, name, one)

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
            if 'table' not in f.metadata
        ]

    @classmethod
    def tables(cls) -> dict[str, Table]:
        """Return the curves, maps and numbers that the effect can have, by name."""
        return {f.name: f.metadata['table'] for f in fields(cls) if 'table' in f.metadata}

    @property
    def forms(self) -> dict[str, Any]:
        """Return the curves, maps and numbers that this effect has, by name."""
        own = {name: getattr(self, name) for name in self.tables()}
        return {name: one for name, one in own.items() if one is not None}

    @property
    def has_kernel(self) -> bool:
        """Return whether the kernels of `flexx2_sim_ros.batch` can compute it as it is."""
        return self.batched is not None and not self.forms

    @property
    def settings(self) -> dict[str, Any]:
        """Return all that `from_mapping` needs to make the effect again: numbers, curves, maps."""
        return {**{p.name: getattr(self, p.name) for p in self.parameters()}, **self.forms}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any] | None) -> 'Effect':
        """
        Build from names and numbers, curves or maps, as in a YAML file.

        Raises
        ------
        InputError
            For an unknown name or a value out of bounds.

        """
        values = {} if values is None else values
        if not isinstance(values, Mapping):
            raise InputError(f'{cls.name}: must be a table of parameters, got {shown(values)}')
        known = [*(item.name for item in cls.parameters()), *cls.tables()]
        for name in values:
            if name not in known:
                raise InputError(
                    f'{cls.name}.{unquoted(name)}: must be one of {", ".join(known)}, got an '
                    'unknown parameter'
                )
        return cls(**values)

    def constants(self) -> dict[str, float]:
        """
        Return the numbers that the effect's formulas take, by name and in their order.

        By default they are the parameters. They are made once a frame, or once a batch.
        """
        return {item.name: getattr(self, item.name) for item in self.parameters()}

    @property
    def rounded(self) -> tuple[np.float32, ...]:
        """Return the numbers of `constants` as float32."""
        return tuple(map(np.float32, self.constants().values()))

    def apply(self, state: FrameState) -> None:
        """Change the frame in the making."""
        raise NotImplementedError


def stream_of(name: str) -> int:
    """Return the number of an effect's random stream, the same everywhere and always."""
    digest = hashlib.blake2b(str(name).encode(), digest_size=4).digest()
    return _OWN_STREAMS + int.from_bytes(digest, 'little') % (2**32 - _OWN_STREAMS)


def check_maps(effects: Iterable[Effect], width: int, height: int) -> None:
    """
    Raise InputError where a map of an effect is not of `width` x `height` pixels.

    Effects of strength 0 may have any map. The error names the effect and both sizes.
    """
    for effect in effects:
        for name, one in effect.forms.items():
            if not effect.strength or not isinstance(one, PixelMap):
                continue
            rows, columns = one.values.shape
            if (columns, rows) != (width, height):
                raise InputError(
                    f'effects: {effect.name}.{name}: must be a map of {width} x {height} pixels, '
                    f'the size of the images, got {columns} x {rows}'
                )

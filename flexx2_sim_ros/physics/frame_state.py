"""One frame in the making: what effects look at and change, stage by stage."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from enum import IntEnum
import math
from typing import Any, ClassVar, Protocol

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.philox import fill_uniforms, stamp_words
from flexx2_sim_ros.physics.surface import Surface
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode
from flexx2_sim_ros.profiles.sensor import KINDS
import numpy as np

SPEED_OF_LIGHT = 299_792_458.0
_PHASES = 4  # assumed: the raw frames of a frequency, as `motion_artefact` takes them


class Stage(IntEnum):
    """The order of light: what happens before what."""

    GEOMETRY = 0
    AMPLITUDE = 1
    PHASOR = 2
    NOISE = 3
    WRAP = 4
    FILTER = 5
    STORAGE = 6
    DROPOUT = 7


@dataclass
class Memory:
    """
    What effects keep of one camera between frames: ``kept``, by the effect's name.

    An effect alone knows what it keeps there. ``first_stamp`` and ``last_stamp`` are of the first
    frame since the reset (when the camera was switched on, as far as it knows) and of the latest
    one, nanoseconds.
    """

    kept: dict[str, Any] = field(default_factory=dict)
    first_stamp: int = 0
    last_stamp: int | None = None

    def begin(self, stamp: int) -> None:
        """Register a new frame; a stamp earlier than the latest one starts again."""
        if self.last_stamp is None or stamp < self.last_stamp:
            self.kept.clear()
            self.first_stamp = stamp
        self.last_stamp = stamp

    def keep_only(self, names: Collection[str]) -> None:
        """Forget what effects of other names keep."""
        self.kept = {name: kept for name, kept in self.kept.items() if name in names}


@dataclass(frozen=True)
class Common:
    """
    What states of the same frame have in common, whatever their effects: made once, by `once`.

    ``scene`` has the light and the noise of the model, by name. States that share it have the same
    clean depth, reflectivity and intrinsics. ``frame`` has the random numbers and what depends on
    them. States that share it also have the same stamp, key and ``exposure_share``.
    """

    scene: dict[Any, Any] = field(default_factory=dict)
    frame: dict[Any, Any] = field(default_factory=dict)


def once(kept: dict[Any, Any] | None, key: Any, make: Callable[[], Any]) -> Any:
    """Return what is kept under a key, made if it is not there yet; without a place, made."""
    if kept is None:
        return make()
    if key not in kept:
        kept[key] = make()
    return kept[key]


@dataclass
class FrameState:
    """
    One frame in the making.

    All images are (H, W). A stage finds the fields of the stages before it filled in; which field
    belongs to which stage is said below. Effects may change them in place or replace them; from
    WRAP on only ``measured`` in place.

    Attributes
    ----------
    mode : Mode
    intrinsics : Intrinsics
        Of the image, as it was given: what the user believes.
    stamp : int
        Nanoseconds.
    key : numpy.ndarray
        (2,) uint32, the camera's random key.
    memory : Memory
        Of this camera.
    depth : numpy.ndarray
        GEOMETRY: float32 clean depth, metres. Whatever is no distance means nothing; from
        AMPLITUDE on that is NaN.
    reflectivity : numpy.ndarray
        GEOMETRY: float32 in 0..1, (H, W) or (1, 1).
    exposure_share : float
        Exposure time as a fraction of the one that the effects' parameters are for.
    surface : Surface
        AMPLITUDE: jumps and incidence of ``depth``.
    amplitude : numpy.ndarray
        AMPLITUDE: float32, reflectivity * cos(incidence) / z^2, 1/m^2; 0 for nothing.
    shifts : list of numpy.ndarray
        PHASOR: float32, for each modulation frequency what is added to depth, metres; one where
        they are not known.
    sigma : numpy.ndarray
        NOISE: float32 sigma_z of what is seen, metres.
    normals : numpy.ndarray
        NOISE: float32 standard normals of the axial noise.
    edge_sigma : float
        NOISE: standard deviation of an edge's position, pixels.
    cosine : numpy.ndarray
        AMPLITUDE: float32 cosine of the incidence angle; from WRAP on of what is seen.
    edge_laplace : float
        NOISE: fraction of edges that move by a Laplacian instead of a Gaussian.
    measured : numpy.ndarray
        WRAP and later: float32 depth with noise, metres, NaN where invalid.
    saturated : numpy.ndarray or None
        DROPOUT: bool, invalid because of too much light.
    common : Common or None
        Shared with other states of the same frame, if there are any; for the pipeline alone.
        What effects may change in place it gives each state of its own, but for ``depth`` and
        ``reflectivity``, which are copied before effects of GEOMETRY.

    """

    mode: Mode
    intrinsics: Intrinsics
    stamp: int
    key: np.ndarray
    memory: Memory
    depth: np.ndarray
    reflectivity: np.ndarray
    exposure_share: float = 1.0
    surface: Surface = None  # type: ignore[assignment]
    amplitude: np.ndarray = None  # type: ignore[assignment]
    shifts: list[np.ndarray] = field(default_factory=list)
    sigma: np.ndarray = None  # type: ignore[assignment]
    normals: np.ndarray = None  # type: ignore[assignment]
    edge_sigma: float = 0.0
    edge_laplace: float = 0.0
    cosine: np.ndarray = None  # type: ignore[assignment]
    measured: np.ndarray = None  # type: ignore[assignment]
    saturated: np.ndarray | None = None
    common: Common | None = None

    @property
    def signal(self) -> np.ndarray:
        """Return the light collected: amplitude times exposure, (H, W) float32, 1/m^2."""
        if self.exposure_share == 1.0:
            return self.amplitude
        return self.amplitude * np.float32(self.exposure_share)

    @property
    def wave_numbers(self) -> list[float]:
        """Return radians of phase a metre of depth, 4 pi f / c, for each modulation frequency."""
        return [4.0 * math.pi * f / SPEED_OF_LIGHT for f in self.mode.modulation_hz]

    @property
    def weights(self) -> list[float]:
        """Return each frequency's weight in the depth: by its square, as its noise asks for."""
        if not self.mode.modulation_hz:
            return [1.0]
        squares = [f * f for f in self.mode.modulation_hz]
        return [square / sum(squares) for square in squares]

    @property
    def spans(self) -> list[float]:
        """Return the depth after which each frequency's phase repeats, metres: c / 2f."""
        return [SPEED_OF_LIGHT / (2.0 * f) for f in self.mode.modulation_hz]

    @property
    def ambiguity(self) -> float:
        """
        Return the depth after which all phases together repeat, metres.

        c / 2 of the frequencies' common beat, each taken to the whole megahertz: what is not in
        a simple ratio does not repeat within any camera's range.
        """
        whole = [max(round(f / 1e6), 1) for f in self.mode.modulation_hz]
        beat = math.gcd(*whole)
        wraps = [n // beat for n in whole]
        return sum(n * span for n, span in zip(wraps, self.spans, strict=True)) / len(wraps)

    @property
    def acquisition_seconds(self) -> float:
        """
        Return how long the raw frames of one depth frame take: at most until the next one.

        An unknown exposure is as long as that allows; if it is not known how many raw frames there
        are, there are four for each frequency.
        """
        mode = self.mode
        raw_frames = mode.raw_frames or _PHASES * len(mode.modulation_hz)
        taken = raw_frames * (mode.exposure_us[1] + mode.sensor.readout_us) * 1e-6
        return min(taken, 1.0 / mode.rate_hz)

    def uniforms(self, stream: int) -> np.ndarray:
        """Return (H, W) float32 random numbers in (0, 1] that no other stream shares."""
        out = np.empty(self.depth.shape, np.float32)
        low, high = stamp_words(self.stamp)
        fill_uniforms(self.key, low, high, stream, out.ravel())
        return out

    def no_shifts(self) -> list[np.ndarray]:
        """Return zeros for `shifts`."""
        return [np.zeros_like(self.depth) for _ in self.weights]

    def add_shift(self, metres: Any) -> None:
        """Add the same shift at every frequency, as a delay does."""
        for shift in self.shifts:
            shift += metres


class EffectProtocol(Protocol):
    """What the pipeline asks of an effect; see `flexx2_sim_ros.effects`."""

    name: ClassVar[str]
    stage: ClassVar[Stage]
    order: ClassVar[int]
    needs_modulation: ClassVar[bool]

    @property
    def strength(self) -> float:
        """Return 0 for off, 1 for typical."""
        ...

    def apply(self, state: FrameState) -> None:
        """Change the frame in the making."""


def why_no_phases(mode: Mode) -> str:
    """Say why effects on the phases of modulated light cannot be on in a mode; empty: they can."""
    if mode.modulation_hz:
        return ''
    if mode.sensor.kind != 'tof':
        return f'does not apply to a {KINDS[mode.sensor.kind]}'
    return 'needs the modulation frequencies, which the profile does not give'


def check_frequencies(effects: Iterable[EffectProtocol], mode: Mode) -> None:
    """
    Check that a mode has modulation frequencies, and that they are known, where effects need them.

    Effects of strength 0 need nothing. Raises InputError, which names the effects, and either the
    kind of camera or the field of the profile.
    """
    reason = why_no_phases(mode)
    if not reason:
        return
    names = [effect.name for effect in effects if effect.strength and effect.needs_modulation]
    if names:
        field = f' (modes.{mode.name}.modulation_hz)' if mode.sensor.kind == 'tof' else ''
        raise InputError(
            f'effects: {", ".join(names)}: must not be on in {mode.name}: {reason}{field}'
        )

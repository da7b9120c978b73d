"""Effects that shift depth: delays, harmonics, temperature, amplitude, pixels."""

from dataclasses import dataclass
from functools import lru_cache
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT, Stage
from flexx2_sim_ros.physics.philox import fill_normals, STREAM_FIXED_PATTERN
import numpy as np


@dataclass(frozen=True)
class Wiggling(Effect):
    """Harmonics of the modulation."""

    name: ClassVar[str] = 'wiggling'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 10
    title: ClassVar[str] = 'harmonics of the modulation: a bias periodic in distance'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Drayton 2013: 18 mm RMS uncalibrated, 3 mm corrected; Lindner 2010. '
        'Four taps leave the fourth harmonic'
    )
    needs_modulation: ClassVar[bool] = True

    a1: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, one period per c/2f')
    b1: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, one period per c/2f')
    a2: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, two periods per c/2f')
    b2: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, two periods per c/2f')
    a3: float = parameter(0.0, -0.1, 0.1, 'm', 'sine, three periods per c/2f')
    b3: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, three periods per c/2f')
    a4: float = parameter(0.0042, -0.1, 0.1, 'm', 'sine, four periods per c/2f')
    b4: float = parameter(0.0, -0.1, 0.1, 'm', 'cosine, four periods per c/2f')

    def apply(self, state: FrameState) -> None:
        """Add the harmonics of what has been mixed so far, at every modulation frequency."""
        for frequency, shift in zip(state.mode.modulation_hz, state.shifts, strict=True):
            step = np.float32(2.0 * math.pi * 2.0 * frequency / SPEED_OF_LIGHT)
            phase = step * (state.depth + shift)
            for k in (1, 2, 3, 4):
                a, b = getattr(self, f'a{k}'), getattr(self, f'b{k}')
                if a:
                    shift += np.float32(self.strength * a) * np.sin(np.float32(k) * phase)
                if b:
                    shift += np.float32(self.strength * b) * np.cos(np.float32(k) * phase)


@dataclass(frozen=True)
class FixedPattern(Effect):
    """A delay of each pixel's own."""

    name: ClassVar[str] = 'fixed_pattern'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 11
    title: ClassVar[str] = "a delay of each pixel's own: the same grain in every scene"
    covariate: ClassVar[str] = 'image'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'Azure Kinect: 0.9 mm, the same to 0.87 in two captures; 1-5 mm usual'
    keeps: ClassVar[bool] = True

    rms: float = parameter(0.0015, 0.0, 0.1, 'm', 'root mean square over the pixels')

    def apply(self, state: FrameState) -> None:
        """Add the camera's pattern, made once from its key."""
        pattern = state.memory.kept.get(self.name)
        if pattern is None or pattern.shape != state.depth.shape:
            pattern = _grain(state.key.tobytes(), state.depth.shape)
            state.memory.kept[self.name] = pattern
        state.add_shift(np.float32(self.strength * self.rms) * pattern)


@lru_cache(maxsize=8)  # Environments of one camera share it.
def _grain(key: bytes, shape: tuple[int, ...]) -> np.ndarray:
    # White noise less its mean over 5 x 5 pixels, scaled to unit variance.
    white = np.empty(shape, np.float32)
    zero = np.uint32(0)
    fill_normals(
        np.frombuffer(key, np.uint32).copy(), zero, zero, STREAM_FIXED_PATTERN, white.ravel()
    )
    padded = np.pad(white, 2, mode='reflect' if min(shape) > 2 else 'edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    grain = white - windows.mean(axis=(-2, -1), dtype=np.float32)
    spread = float(grain.std())
    return (grain / spread if spread > 0 else grain).astype(np.float32)


@dataclass(frozen=True)
class AmplitudeBias(Effect):
    """Pixels that answer non-linearly."""

    name: ClassVar[str] = 'amplitude_bias'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 12
    title: ClassVar[str] = 'non-linear pixels: a bias that grows as the amplitude falls'
    covariate: ClassVar[str] = 'amplitude'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'Kinect v2: white minus black -2.7 mm at 0.95 m, -10.4 at 1.2 m'

    intercept: float = parameter(0.0, -0.1, 0.1, 'm', 'added to every depth')
    slope: float = parameter(-0.003, -0.1, 0.1, 'm', 'bias a factor e below the knee')
    knee: float = parameter(1.0, 1e-3, 100.0, '1/m^2', 'amplitude above which there is none')
    span: float = parameter(3.0, 0.1, 10.0, '', 'factors of e after which it is held')

    def apply(self, state: FrameState) -> None:
        """Add the clipped hinge in the logarithm of the amplitude."""
        with np.errstate(divide='ignore'):
            below = np.log(state.signal) - np.float32(math.log(self.knee))
        hinge = np.clip(below, np.float32(-self.span), np.float32(0))
        state.add_shift(
            np.float32(self.strength * self.intercept)
            + np.float32(self.strength * self.slope) * hinge
        )


@dataclass(frozen=True)
class Offset(Effect):
    """A delay in the electronics."""

    name: ClassVar[str] = 'offset'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 13
    title: ClassVar[str] = 'delay in the electronics: the same bias everywhere'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'design: the paper set distances to 10 mm and leaves bias out'

    bias: float = parameter(0.005, -0.2, 0.2, 'm', 'added to every depth')

    def apply(self, state: FrameState) -> None:
        """Add the bias."""
        state.add_shift(np.float32(self.strength * self.bias))


@dataclass(frozen=True)
class WarmUpDrift(Effect):
    """Temperature after power-on."""

    name: ClassVar[str] = 'warm_up_drift'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 14
    title: ClassVar[str] = 'temperature: a common bias that decays after power-on'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Toelgyessy 2021: 40 to 50 min on an Azure Kinect; Basler blaze: +-5 mm after 20 min'
    )
    keeps: ClassVar[bool] = True

    bias: float = parameter(0.010, -0.2, 0.2, 'm', 'at power-on')
    tau: float = parameter(900.0, 1.0, 36000.0, 's', 'time constant')
    uptime: float = parameter(0.0, 0.0, 1e6, 's', 'already on for this long at the first frame')

    def apply(self, state: FrameState) -> None:
        """Add the bias of this moment."""
        seconds = self.uptime + (state.stamp - state.memory.first_stamp) * 1e-9
        state.add_shift(np.float32(self.strength * self.bias * math.exp(-seconds / self.tau)))

"""Phase noise wiggling: noise that depends on the phase."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Term
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas.fastmath import direction
from flexx2_sim_ros.formulas.scalars import f32, most
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, SPEED_OF_LIGHT, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_ONE = f32(1.0)
_LEAST = f32(0.01)  # of the variance: some noise stays


def variance_factor(turns: float, sine: float, cosine: float, periods: float) -> float:
    """Return the factor on the variance at a phase in `turns`."""
    c, s = direction(periods * turns)
    return most(_ONE + sine * s + cosine * c, _LEAST)


# Two pairs of taps that differ in noise give two periods, four different taps four.
def _with_periods(label: str, periods: float) -> Hypothesis:
    off = {'sine': 0.0, 'cosine': 0.0, 'periods': periods}
    sine = Term('sine', (0.4,), -0.9, 0.9, fixed={'cosine': 0.0, 'periods': periods})
    cosine = Term('cosine', (0.4,), -0.9, 0.9, fixed={'sine': 0.0, 'periods': periods})
    return Hypothesis(label, (sine, cosine), off)


@dataclass(frozen=True)
class PhaseNoiseWiggling(Effect):
    """Noise that depends on the phase."""

    name: ClassVar[str] = 'phase_noise_wiggling'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 4
    title: ClassVar[str] = 'taps that differ in noise: noise periodic in distance'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('noise',)
    source: ClassVar[str] = (
        'Koehler 2025 (doi 10.3390/s25010109): calibration cannot remove it; the size is assumed'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        _with_periods('two periods', 2.0),
        _with_periods('four periods', 4.0),
    )
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'noise periodic in distance'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('spread', 'distance'),)
    picture: ClassVar[Picture] = Picture(usecase='Mode_5_30fps')
    batched: ClassVar[tuple[str, ...] | None] = ('sigma',)

    sine: float = parameter(0.0, -1.0, 1.0, '', 'of the phase, in the factor on the variance')
    cosine: float = parameter(0.4, -1.0, 1.0, '', 'the same, of its cosine')
    periods: float = parameter(2.0, 1.0, 8.0, '', 'of the noise, per c/2f')

    def constants(self) -> dict[str, float]:
        """Return sine and cosine of the factor on the variance, and the periods per c/2f."""
        return {
            'sine': self.strength * self.sine,
            'cosine': self.strength * self.cosine,
            'periods': self.periods,
        }

    def apply(self, state: FrameState) -> None:
        """Scale the variance of each modulation frequency by its own phase."""
        variance = np.zeros_like(state.depth)
        parts = zip(state.mode.modulation_hz, state.weights, state.shifts, strict=True)
        for frequency, weight, shift in parts:
            turns = np.float32(2.0 * frequency / SPEED_OF_LIGHT)
            _add_variance(state.depth, shift, turns, np.float32(weight), *self.rounded, variance)
        state.sigma = state.sigma * np.sqrt(variance)


_variance_factor = compiled(variance_factor)


@loop(error_model='numpy', fastmath=FAST)
def _add_variance(depth, shift, turns, weight, sine, cosine, periods, variance):
    # turns: of phase a metre.
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            phase = turns * (depth[y, x] + shift[y, x])
            variance[y, x] += weight * _variance_factor(phase, sine, cosine, periods)

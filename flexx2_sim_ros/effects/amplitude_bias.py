"""Amplitude bias: pixels that answer non-linearly."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, StandIn, Term
from flexx2_sim_ros.effects.line_of_sight import add_along_ray, log_amplitude
from flexx2_sim_ros.effects.offset import Offset, SIMULATED_BIAS
from flexx2_sim_ros.effects.tables import Curve, curve_over
from flexx2_sim_ros.formulas.fastmath import log_from_zero
from flexx2_sim_ros.formulas.scalars import f32, least, most
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_ZERO = f32(0.0)


def dark_bias(
    amplitude: float, intercept: float, slope: float, log_knee: float, span: float
) -> float:
    """Return the shift of a pixel, metres: a hinge in the logarithm of its amplitude."""
    below = log_from_zero(amplitude) - log_knee
    return intercept + slope * least(most(below, -span), _ZERO)


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
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        Hypothesis(
            f'knee {knee:g}',
            (
                # Without its slope it is an offset.
                Term(
                    'intercept',
                    (SIMULATED_BIAS,),
                    -0.05,
                    0.05,
                    stand_in=StandIn(Offset.name, 'bias', SIMULATED_BIAS),
                    along_ray='bias',
                ),
                Term('slope', (-0.003,), -0.05, 0.05, fixed={'knee': knee, 'span': span}),
            ),
            {'knee': knee, 'span': span},
        )
        for knee, span in ((0.1, 3.0), (0.4, 3.0), (1.0, 3.0), (3.0, 5.0))
    )
    smooth: ClassVar[bool] = True
    brightness: ClassVar[float] = 0.1
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'reflectivity')
    family: ClassVar[str] = 'function of amplitude'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'amplitude'),)
    batched: ClassVar[tuple[str, ...] | None] = ('shift',)

    intercept: float = parameter(0.0, -0.1, 0.1, 'm', 'added to every depth')
    slope: float = parameter(
        -0.003, -0.1, 0.1, 'm', 'change per factor of e in amplitude, below the knee'
    )
    knee: float = parameter(1.0, 1e-3, 100.0, '1/m^2', 'amplitude above which there is no bias')
    span: float = parameter(3.0, 0.1, 10.0, '', 'constant bias from this many factors of e on')

    curve: Curve | None = curve_over(
        'ln of the amplitude, 1/m^2',
        'm',
        -0.5,
        0.5,
        'added to the range along the ray, in place of the hinge',
    )

    def constants(self) -> dict[str, float]:
        """Return intercept and slope, metres, the knee's logarithm, and the span."""
        return {
            'intercept': self.strength * self.intercept,
            'slope': self.strength * self.slope,
            'log_knee': math.log(self.knee),
            'span': self.span,
        }

    def apply(self, state: FrameState) -> None:
        """Add the clipped hinge in the logarithm of the amplitude."""
        if self.curve is not None:
            add_along_ray(state, self.strength, self.curve.at(log_amplitude(state.signal)))
            return
        shift = np.empty_like(state.depth)
        _biases(state.signal, *self.rounded, shift)
        state.add_shift(shift)


_dark_bias = compiled(dark_bias)


@loop(error_model='numpy', fastmath=FAST)
def _biases(amplitude, intercept, slope, log_knee, span, out):
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = _dark_bias(amplitude[y, x], intercept, slope, log_knee, span)

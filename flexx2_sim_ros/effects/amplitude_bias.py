"""Amplitude bias: pixels that answer non-linearly."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, StandIn, Term
from flexx2_sim_ros.effects.offset import Offset, SIMULATED_BIAS
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


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
    batched: ClassVar[tuple[str, ...] | None] = ()

    intercept: float = parameter(0.0, -0.1, 0.1, 'm', 'added to every depth')
    slope: float = parameter(-0.003, -0.1, 0.1, 'm', 'bias at a factor of e below the knee')
    knee: float = parameter(1.0, 1e-3, 100.0, '1/m^2', 'amplitude above which there is no bias')
    span: float = parameter(3.0, 0.1, 10.0, '', 'constant bias from this many factors of e on')

    def apply(self, state: FrameState) -> None:
        """Add the clipped hinge in the logarithm of the amplitude."""
        with np.errstate(divide='ignore'):
            below = np.log(state.signal) - np.float32(math.log(self.knee))
        hinge = np.clip(below, np.float32(-self.span), np.float32(0))
        state.add_shift(
            np.float32(self.strength * self.intercept)
            + np.float32(self.strength * self.slope) * hinge
        )

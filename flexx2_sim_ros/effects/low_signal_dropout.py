"""Low-signal dropout: too little light."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Searched
from flexx2_sim_ros.effects.line_of_sight import log_amplitude
from flexx2_sim_ros.effects.losing import kept_by, lose, lost_as_found, lost_beyond, survival
from flexx2_sim_ros.effects.tables import Curve, curve_over
from flexx2_sim_ros.formulas.fastmath import log_from_zero
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np


def survives_darkness(
    log_amplitude: float, log_half: float, slope: float, strength: float
) -> float:
    """Return the chance that a pixel of this amplitude stays valid."""
    return survival(slope * (log_half - log_amplitude), strength)


@dataclass(frozen=True)
class LowSignalDropout(Effect):
    """Too little light."""

    name: ClassVar[str] = 'low_signal_dropout'
    stage: ClassVar[Stage] = Stage.DROPOUT
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'too little light (black, metal, far): invalid pixels'
    covariate: ClassVar[str] = 'amplitude'
    changes: ClassVar[tuple[str, ...]] = ('validity',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Kinect v2: 99.8 % invalid below IR 50, 9 % at 400-800, < 1 % above '
        '2000; the level here is assumed'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = lost_beyond(0.004, 0.012, 0.036, 0.11)
    searched: ClassVar[Searched | None] = Searched('darkness', lost_as_found)
    smooth: ClassVar[bool] = True
    brightness: ClassVar[float] = 0.5
    nuisances: ClassVar[tuple[str, ...]] = ('reflectivity',)
    family: ClassVar[str] = 'threshold on amplitude'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('invalid', 'amplitude'), ('invalid', ''))
    stream: ClassVar[int] = 6
    batched: ClassVar[tuple[str, ...] | None] = ()

    half: float = parameter(0.012, 1e-5, 10.0, '1/m^2', 'amplitude at which half are invalid')
    slope: float = parameter(3.0, 0.1, 20.0, '', 'slope of the logistic function, per factor e')

    curve: Curve | None = curve_over(
        'ln of the amplitude, 1/m^2',
        '',
        0.0,
        1.0,
        'probability that a pixel is invalid, in place of the logistic function',
    )

    def constants(self) -> dict[str, float]:
        """Return the logarithm of the amplitude at which half are lost, slope and strength."""
        return {'log_half': math.log(self.half), 'slope': self.slope, 'strength': self.strength}

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in the logarithm of the amplitude, falling."""
        if self.curve is not None:
            lost = self.curve.at(log_amplitude(state.signal))
            lose(state, kept_by(lost, self.strength), self.stream)
            return
        survives = np.empty_like(state.depth)
        _survives(state.signal, *self.rounded, survives)
        lose(state, survives, self.stream)


_log_from_zero = compiled(log_from_zero)
_survives_darkness = compiled(survives_darkness)


@loop(error_model='numpy', fastmath=FAST)
def _survives(amplitude, log_half, slope, strength, out):
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            light = _log_from_zero(amplitude[y, x])
            out[y, x] = _survives_darkness(light, log_half, slope, strength)

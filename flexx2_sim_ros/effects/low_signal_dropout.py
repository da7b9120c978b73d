"""Low-signal dropout: too little light."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.losing import log_signal, lose
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


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
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        grid('strength', (0.4, 1.6), 0.0, 4.0, f'half {half:g}', half=half)
        for half in (0.004, 0.012, 0.036, 0.11)
    )
    smooth: ClassVar[bool] = True
    brightness: ClassVar[float] = 0.5
    nuisances: ClassVar[tuple[str, ...]] = ('reflectivity',)
    family: ClassVar[str] = 'threshold on amplitude'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('invalid', 'amplitude'), ('invalid', ''))
    stream: ClassVar[int] = 6
    batched: ClassVar[tuple[str, ...] | None] = ()

    half: float = parameter(0.012, 1e-5, 10.0, '1/m^2', 'amplitude at which half are invalid')
    slope: float = parameter(3.0, 0.1, 20.0, '', 'slope of the logistic function, per factor e')

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in the logarithm of the amplitude, falling."""
        logit = np.float32(-self.slope) * log_signal(state, self.half)
        lose(state, logit, self.strength, self.stream)

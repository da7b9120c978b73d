"""Saturation: too much light."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.losing import log_signal, lose
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


@dataclass(frozen=True)
class Saturation(Effect):
    """Too much light."""

    name: ClassVar[str] = 'saturation'
    stage: ClassVar[Stage] = Stage.DROPOUT
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'too much light (near, white, specular head-on): invalid pixels'
    covariate: ClassVar[str] = 'amplitude'
    changes: ClassVar[tuple[str, ...]] = ('validity',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Kinect v2: 97 % invalid at the top of the IR scale, 44 % of a white '
        "board at 0.5-0.6 m; the paper's anomaly at 0 degrees"
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        grid('strength', (0.4, 1.6), 0.0, 4.0, f'half {half:g}', half=half)
        for half in (1.0, 2.0, 3.5, 6.0)
    )
    smooth: ClassVar[bool] = True
    brightness: ClassVar[float] = 0.8
    nuisances: ClassVar[tuple[str, ...]] = ('reflectivity',)
    family: ClassVar[str] = 'threshold on amplitude'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('invalid', 'distance'),)
    stream: ClassVar[int] = 8
    batched: ClassVar[tuple[str, ...] | None] = ()

    half: float = parameter(3.5, 1e-2, 1000.0, '1/m^2', 'amplitude at which half are invalid')
    slope: float = parameter(6.0, 0.1, 50.0, '', 'slope of the logistic function, per factor e')
    gloss: float = parameter(
        0.5, 0.0, 20.0, '', 'specular fraction added where a surface faces the camera'
    )
    lobe_deg: float = parameter(4.0, 0.2, 45.0, 'deg', 'width of the specular lobe')

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in the logarithm of the amplitude, rising."""
        incidence = np.arccos(np.clip(state.cosine, 0, 1))
        lobe = np.exp(-((incidence / np.float32(math.radians(self.lobe_deg))) ** 2))
        gain = np.log(np.float32(1) + np.float32(self.gloss) * lobe)
        logit = np.float32(self.slope) * (log_signal(state, self.half) + gain)
        lost = lose(state, logit, self.strength, self.stream)
        state.saturated = lost & np.isfinite(state.depth)
        if state.saturated.any():
            # A full well says "at least this much": white in the gray image.
            light = state.amplitude * np.exp(gain)
            full = np.float32(state.mode.sensor.full_scale_amplitude / state.exposure_share)
            state.amplitude = np.where(
                state.saturated, np.maximum(light[state.saturated].max(), full), state.amplitude
            )

"""Effects that lose pixels."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import STREAM_GRAZING, STREAM_LOW_SIGNAL, STREAM_SATURATION
from flexx2_sim_ros.profiles.modes import camera_config
import numpy as np


def _lose(state: FrameState, logit: np.ndarray, strength: float, stream: int) -> np.ndarray:
    # Strength is how often the chance is taken: 1 - (1 - p)^strength, with p = 1 / (1 + e^-logit).
    # Returns which pixels were lost.
    with np.errstate(over='ignore'):
        survives = (np.float32(1) + np.exp(logit)) ** np.float32(-strength)
    lost: np.ndarray = state.uniforms(stream) > survives
    state.measured[lost] = np.nan
    return lost


def _log_signal(state: FrameState, half: float) -> np.ndarray:
    with np.errstate(divide='ignore'):
        return np.log(state.signal) - np.float32(math.log(half))


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
        '2000; level here is design'
    )

    half: float = parameter(0.012, 1e-5, 10.0, '1/m^2', 'amplitude at which half are lost')
    slope: float = parameter(3.0, 0.1, 20.0, '', 'of the logistic, per factor e of amplitude')

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in the logarithm of the amplitude, falling."""
        logit = np.float32(-self.slope) * _log_signal(state, self.half)
        _lose(state, logit, self.strength, STREAM_LOW_SIGNAL)


@dataclass(frozen=True)
class GrazingDropout(Effect):
    """Too slanted."""

    name: ClassVar[str] = 'grazing_dropout'
    stage: ClassVar[Stage] = Stage.DROPOUT
    order: ClassVar[int] = 1
    title: ClassVar[str] = "the camera's gate on its noise: invalid pixels at slants"
    covariate: ClassVar[str] = 'incidence'
    changes: ClassVar[tuple[str, ...]] = ('validity',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'pico driver: noise threshold 0.07 m; shape is design'

    half_deg: float = parameter(76.0, 20.0, 90.0, 'deg', 'incidence at which half are lost at 1 m')
    width_deg: float = parameter(3.0, 0.2, 20.0, 'deg', 'of the logistic')
    distance: float = parameter(1.0, 0.0, 10.0, '', 'logit added per factor e of distance')

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in incidence and in the logarithm of the distance."""
        incidence = np.degrees(np.arccos(np.clip(state.cosine, 0, 1)))
        with np.errstate(invalid='ignore'):
            logit = (incidence - np.float32(self.half_deg)) / np.float32(
                self.width_deg
            ) + np.float32(self.distance) * np.log(state.depth)
        _lose(state, logit, self.strength, STREAM_GRAZING)


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

    half: float = parameter(3.5, 1e-2, 1000.0, '1/m^2', 'amplitude at which half are lost')
    slope: float = parameter(6.0, 0.1, 50.0, '', 'of the logistic, per factor e of amplitude')
    gloss: float = parameter(0.5, 0.0, 20.0, '', 'specular share added facing the camera')
    lobe_deg: float = parameter(4.0, 0.2, 45.0, 'deg', 'width of the specular lobe')

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in the logarithm of the amplitude, rising."""
        incidence = np.arccos(np.clip(state.cosine, 0, 1))
        lobe = np.exp(-((incidence / np.float32(math.radians(self.lobe_deg))) ** 2))
        gain = np.log(np.float32(1) + np.float32(self.gloss) * lobe)
        logit = np.float32(self.slope) * (_log_signal(state, self.half) + gain)
        lost = _lose(state, logit, self.strength, STREAM_SATURATION)
        state.saturated = lost & np.isfinite(state.depth)
        if state.saturated.any():
            # A full well says "at least this much": white in the gray image.
            light = state.amplitude * np.exp(gain)
            full = np.float32(camera_config().full_scale_amplitude / state.exposure_share)
            state.amplitude = np.where(
                state.saturated, np.maximum(light[state.saturated].max(), full), state.amplitude
            )

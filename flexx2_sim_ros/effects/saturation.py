"""Saturation: too much light."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis, Searched
from flexx2_sim_ros.effects.line_of_sight import log_amplitude
from flexx2_sim_ros.effects.losing import glare_as_found, kept_by, lose, lost_beyond, survival
from flexx2_sim_ros.effects.tables import Curve, curve_over, optional_number
from flexx2_sim_ros.formulas.fastmath import arccos, exp, log, log_from_zero
from flexx2_sim_ros.formulas.scalars import f32
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_ONE = f32(1.0)


def specular_gain(incidence: float, gloss: float, lobe: float) -> float:
    """Return the factor on a glossy surface's light; ``lobe``: how wide it is, radians."""
    angle = incidence / lobe
    return _ONE + gloss * exp(-angle * angle)


def survives_light(
    log_amplitude: float, gain: float, log_half: float, slope: float, strength: float
) -> float:
    """Return the chance that a pixel of this amplitude, times a gain, stays valid."""
    return survival(slope * (log_amplitude + log(gain) - log_half), strength)


def bled(log_amplitude: np.ndarray, reach: float) -> np.ndarray:
    """
    Return the largest light, (H, W), that runs up or down the columns into each pixel.

    Light is the logarithm of amplitudes. It loses 1 in every ``reach`` pixels.
    """
    out = log_amplitude.copy()
    fall = np.float32(1 / reach)
    for down in (out, out[::-1]):
        for above, here in zip(down[:-1], down[1:], strict=True):
            np.fmax(here, above - fall, out=here)
    return out


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
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = lost_beyond(1.0, 2.0, 3.5, 6.0)
    searched: ClassVar[Searched | None] = Searched('glare', glare_as_found)
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

    curve: Curve | None = curve_over(
        'ln of the amplitude, 1/m^2',
        '',
        0.0,
        1.0,
        'probability that a pixel is invalid, in place of the logistic function and gloss',
    )
    bleed: float | None = optional_number(
        'px', 0.1, 100.0, 'light that bleeds up and down columns falls by e in this many pixels'
    )

    def constants(self) -> dict[str, float]:
        """Return gloss and lobe (radians), then the logistic's half, slope and strength."""
        return {
            'gloss': self.gloss,
            'lobe': math.radians(self.lobe_deg),
            'log_half': math.log(self.half),
            'slope': self.slope,
            'strength': self.strength,
        }

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in the logarithm of the amplitude, rising."""
        gain, survives = np.ones_like(state.depth), np.empty_like(state.depth)
        if self.curve is None:
            gloss, *rest = self.rounded
            _survives(state.signal, state.cosine, gloss, *rest, gain, survives)
            if self.bleed is not None:
                light = np.exp(bled(log_amplitude(state.signal * gain), self.bleed))
                none = np.zeros_like(gloss)
                _survives(light, state.cosine, none, *rest, np.empty_like(gain), survives)
        else:
            light = log_amplitude(state.signal)
            over = light if self.bleed is None else bled(light, self.bleed)
            survives = kept_by(self.curve.at(over), self.strength)
        lost = lose(state, survives, self.stream)
        state.saturated = lost & np.isfinite(state.depth)
        if state.saturated.any():
            # A full well says "at least this much": white in the gray image.
            light = state.amplitude[state.saturated] * gain[state.saturated]
            full = np.float32(state.mode.sensor.full_scale_amplitude / state.exposure_share)
            state.amplitude = np.where(
                state.saturated, np.maximum(light.max(), full), state.amplitude
            )


_arccos = compiled(arccos)
_specular_gain = compiled(specular_gain)
_log_from_zero = compiled(log_from_zero)
_survives_light = compiled(survives_light)


@loop(error_model='numpy', fastmath=FAST)
def _survives(amplitude, cosine, gloss, lobe, log_half, slope, strength, gain, out):
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            gain[y, x] = _specular_gain(_arccos(cosine[y, x]), gloss, lobe)
            light = _log_from_zero(amplitude[y, x])
            out[y, x] = _survives_light(light, gain[y, x], log_half, slope, strength)

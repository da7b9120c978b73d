"""Grazing dropout: too slanted."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import Hypothesis
from flexx2_sim_ros.effects.losing import kept_by, lose, lost_by, survival
from flexx2_sim_ros.effects.tables import Curve, curve_over
from flexx2_sim_ros.formulas.fastmath import arccos, log_from_zero
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

# Logit per factor e of distance: at 70 degrees, the tangent of the incidence counts as much.
_SPAN = 6.0


def survives_grazing(
    incidence: float, z: float, half: float, width: float, distance: float, strength: float
) -> float:
    """
    Return the chance that a pixel at depth `z`, metres, and `incidence`, radians, stays valid.

    ``half`` is the angle at which half are lost at 1 m, ``width`` the logistic's, both radians;
    ``distance`` is added to the logit per factor e of depth; ``strength`` is as in `survival`.
    """
    logit = (incidence - half) / width + distance * log_from_zero(z)
    return survival(logit, strength)


@dataclass(frozen=True)
class GrazingDropout(Effect):
    """Too slanted."""

    name: ClassVar[str] = 'grazing_dropout'
    stage: ClassVar[Stage] = Stage.DROPOUT
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'noise threshold of the camera: invalid pixels at grazing incidence'
    covariate: ClassVar[str] = 'incidence'
    changes: ClassVar[tuple[str, ...]] = ('validity',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'pico driver: noise threshold 0.07 m; the shape is assumed'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        *(lost_by(f'half {half:g}', half_deg=half) for half in (64.0, 70.0, 76.0, 82.0)),
        # About as the depth that a pixel spans, which filters of flying pixels look at.
        *(
            lost_by(f'span, half {half:g}', half_deg=half, distance=_SPAN)
            for half in (76.0, 82.0, 86.0)
        ),
    )
    smooth: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'threshold on incidence'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('invalid', 'incidence'),)
    stream: ClassVar[int] = 7
    batched: ClassVar[tuple[str, ...] | None] = ()

    half_deg: float = parameter(76.0, 20.0, 90.0, 'deg', 'incidence with half invalid at 1 m')
    width_deg: float = parameter(3.0, 0.2, 20.0, 'deg', 'width of the logistic function')
    distance: float = parameter(1.0, 0.0, 10.0, '', 'logit added per factor e of distance')

    curve: Curve | None = curve_over(
        'incidence, degrees',
        '',
        0.0,
        1.0,
        'probability that a pixel is invalid, in place of the logistic function',
    )
    slant: Curve | None = curve_over(
        'ln of range times tan of incidence, m',
        '',
        0.0,
        1.0,
        'the same, of how much depth a pixel spans; in place of curve',
    )

    def constants(self) -> dict[str, float]:
        """Return half and width in radians, the part of distance, and strength."""
        return {
            'half': math.radians(self.half_deg),
            'width': math.radians(self.width_deg),
            'distance': self.distance,
            'strength': self.strength,
        }

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in incidence and in the logarithm of the distance."""
        lost = self._table(state)
        if lost is not None:
            lose(state, kept_by(lost, self.strength), self.stream)
            return
        survives = np.empty_like(state.depth)
        _survives(state.cosine, state.depth, *self.rounded, survives)
        lose(state, survives, self.stream)

    def _table(self, state: FrameState) -> np.ndarray | None:
        # (H, W) probability to be invalid, if there is a table of it.
        if self.slant is not None:
            length = ray_length(state.intrinsics.matrix, state.depth.shape)
            return self.slant.at(log_slant(state.cosine, state.depth * length))
        if self.curve is not None:
            return self.curve.at(np.degrees(np.arccos(np.clip(state.cosine, 0, 1))))
        return None


def log_slant(cosine: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """
    Return the logarithm of the depth that a pixel spans, for a pixel of one radian, (H, W).

    It is ln(distance tan(incidence)), of metres, from the (H, W) cosine of the incidence angle and
    distance along the ray, metres.
    """
    cosine = np.clip(cosine, np.float32(1e-3), np.float32(1 - 1e-6))
    return np.log(distance * np.sqrt(1 - cosine * cosine) / cosine)


_arccos = compiled(arccos)
_survives_grazing = compiled(survives_grazing)


@loop(error_model='numpy', fastmath=FAST)
def _survives(cosine, depth, half, width, distance, strength, out):
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = _survives_grazing(
                _arccos(cosine[y, x]), depth[y, x], half, width, distance, strength
            )

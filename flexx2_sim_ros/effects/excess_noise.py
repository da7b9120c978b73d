"""Excess noise: more than the model says."""

from dataclasses import dataclass
from typing import Any, ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.line_of_sight import log_amplitude
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.tables import Curve, curve_over
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


def scaled_noise(sigma: float, factor: float) -> float:
    """Return sigma_z times a factor."""
    return sigma * factor


@dataclass(frozen=True)
class ExcessNoise(Effect):
    """More noise than the model says."""

    name: ClassVar[str] = 'excess_noise'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'wrong sigma, or another surface: more axial noise everywhere'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('noise',)
    source: ClassVar[str] = 'assumed; the paper measured one white board'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('factor', (0.8, 1.15, 1.3, 1.6), 0.4, 3.0, neutral=1.0),
    )
    role: ClassVar[str] = 'sigma'
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'factor on the noise'
    compared: ClassVar[str] = 'factor'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('spread', ''),)
    picture: ClassVar[Picture] = Picture('histogram')
    batched: ClassVar[tuple[str, ...] | None] = ('sigma',)

    factor: float = parameter(1.3, 0.2, 5.0, '', 'factor on sigma_z, at strength 1')

    curve: Curve | None = curve_over(
        'ln of the amplitude, 1/m^2', '', 0.1, 10.0, 'factor on sigma_z, in place of one number'
    )
    slant: Curve | None = curve_over(
        'incidence, degrees', '', 0.1, 10.0, 'the same, in place of curve'
    )

    def constants(self) -> dict[str, float]:
        """Return the factor on sigma_z."""
        return {'factor': max(1.0 + self.strength * (self.factor - 1.0), 0.0)}

    def apply(self, state: FrameState) -> None:
        """Scale sigma."""
        state.sigma = on_images(scaled_noise)(state.sigma, *self._factors(state))

    def _factors(self, state: FrameState) -> tuple[Any, ...]:
        # One number, or one for each pixel.
        if self.slant is not None:
            factor = self.slant.at(np.degrees(np.arccos(np.clip(state.cosine, 0, 1))))
        elif self.curve is not None:
            factor = self.curve.at(log_amplitude(state.signal))
        else:
            return self.rounded
        return (np.maximum(1 + np.float32(self.strength) * (factor - 1), 0),)

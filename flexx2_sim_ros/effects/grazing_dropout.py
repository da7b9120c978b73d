"""Grazing dropout: too slanted."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.losing import lose
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


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
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        grid('strength', (0.4, 1.6), 0.0, 4.0, f'half {half:g}', half_deg=half)
        for half in (64.0, 70.0, 76.0, 82.0)
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

    def apply(self, state: FrameState) -> None:
        """Lose pixels by a logistic in incidence and in the logarithm of the distance."""
        incidence = np.degrees(np.arccos(np.clip(state.cosine, 0, 1)))
        with np.errstate(invalid='ignore'):
            logit = (incidence - np.float32(self.half_deg)) / np.float32(
                self.width_deg
            ) + np.float32(self.distance) * np.log(state.depth)
        lose(state, logit, self.strength, self.stream)

"""Quantisation: storage in whole steps."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


@dataclass(frozen=True)
class Quantisation(Effect):
    """Storage in whole steps."""

    name: ClassVar[str] = 'quantisation'
    stage: ClassVar[Stage] = Stage.STORAGE
    title: ClassVar[str] = 'storage or fixed-point phase: depth in whole steps'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('noise',)
    source: ClassVar[str] = 'drivers that store millimetres; the step is assumed'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('step', (0.001, 0.002, 0.004, 0.008), 0.0, 0.02),
    )
    lattice: ClassVar[str] = 'step'
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'rounding'
    compared: ClassVar[str] = 'step'
    picture: ClassVar[Picture] = Picture('steps', 'frame')
    batched: ClassVar[tuple[str, ...] | None] = ()

    step: float = parameter(0.004, 1e-5, 0.2, 'm', 'step between stored depths, at strength 1')

    def apply(self, state: FrameState) -> None:
        """Round to whole steps."""
        step = np.float32(self.strength * self.step)
        state.measured = np.rint(state.measured / step) * step

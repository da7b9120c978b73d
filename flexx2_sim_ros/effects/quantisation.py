"""Quantisation: storage in whole steps."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import nearest
from flexx2_sim_ros.physics.frame_state import FrameState, Stage


def stored(depth: float, step: float) -> float:
    """Return a depth in whole steps."""
    return nearest(depth / step) * step


@dataclass(frozen=True)
class Quantisation(Effect):
    """Storage in whole steps."""

    name: ClassVar[str] = 'quantisation'
    stage: ClassVar[Stage] = Stage.STORAGE
    title: ClassVar[str] = 'storage or fixed-point phase: depth in whole steps'
    covariate: ClassVar[str] = 'none'
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

    def constants(self) -> dict[str, float]:
        """Return the step, metres."""
        return {'step': self.strength * self.step}

    def apply(self, state: FrameState) -> None:
        """Round to whole steps."""
        state.measured = on_images(stored)(state.measured, *self.rounded)

"""Temporal filter: a recursive filter in the camera."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, Shape
from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import f32, size, where
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np

_RESET_SIGMAS = f32(6.0)


def filtered(depth: float, before: float, sigma: float, share: float) -> float:
    """Return a depth mixed with that of the frame before, unless they are 6 sigma apart."""
    return filtered_within(depth, before, _RESET_SIGMAS * sigma, share)


def filtered_within(depth: float, before: float, limit: float, share: float) -> float:
    """Return a depth mixed with that of the frame before, unless they are ``limit`` apart."""
    change = before - depth
    return where(size(change) < limit, depth + share * change, depth)


@dataclass(frozen=True)
class TemporalFilter(Effect):
    """A recursive filter in the camera."""

    name: ClassVar[str] = 'temporal_filter'
    stage: ClassVar[Stage] = Stage.FILTER
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'recursive filter in the camera: less noise, correlated frames'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ('noise', 'frames')
    source: ClassVar[str] = (
        "vendors' adaptive temporal filters; reset at 6 sigma; the fraction is assumed"
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('share', (0.2, 0.4, 0.6, 0.8), 0.0, 0.95, few=False),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('weight', (Free('share', 0.0, 0.98),)),
        Shape('weight and gate', (Free('share', 0.0, 0.98), Free('gate', 1.0, 100.0, log=True))),
    )
    filters: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'filter over frames'
    compared: ClassVar[str] = 'share'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('frames', ''),)
    picture: ClassVar[Picture] = Picture('frames_alike')
    batched: ClassVar[tuple[str, ...] | None] = ('measured',)

    share: float = parameter(0.4, 0.0, 0.98, '', 'weight of the previous frame, at strength 1')
    gate: float | None = optional_number(
        'sigma_z', 0.1, 1000.0, 'a larger change from frame to frame is not filtered; without, 6'
    )

    def constants(self) -> dict[str, float]:
        """Return the weight of the frame before."""
        return {'share': min(self.strength * self.share, 0.98)}

    def apply(self, state: FrameState) -> None:
        """Mix every pixel with the frame before, unless it has changed too much."""
        before = state.memory.kept.get(self.name)
        if before is not None and before.shape == state.measured.shape:
            with np.errstate(invalid='ignore'):
                if self.gate is None:
                    state.measured = on_images(filtered)(
                        state.measured, before, state.sigma, *self.rounded
                    )
                else:
                    state.measured = on_images(filtered_within)(
                        state.measured, before, np.float32(self.gate) * state.sigma, *self.rounded
                    )
        state.memory.kept[self.name] = state.measured.copy()

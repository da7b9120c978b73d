"""Temporal filter: a recursive filter, or a mean of frames, in the camera."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, ClassVar

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
_MOST_SHARE = 0.98
_SHARE, _GATE = Free('share', 0.0, _MOST_SHARE), Free('gate', 1.0, 100.0, log=True)


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
        Shape('weight', (_SHARE,)),
        Shape('weight and gate', (_SHARE, _GATE), quick=True),
        Shape('two filters in a row', (_SHARE, Free('second', 0.0, _MOST_SHARE), _GATE)),
        Shape('mean of frames', (Free('window', 1.0, 8.0), _GATE)),
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
    second: float | None = optional_number(
        '', 0.0, _MOST_SHARE, 'weight of the previous frame in a second filter after the first'
    )
    window: float | None = optional_number(
        'frames', 1.0, 16.0, 'mean of so many frames instead; the oldest counts as a fraction'
    )

    def constants(self) -> dict[str, float]:
        """Return the weight of the frame before."""
        return {'share': min(self.strength * self.share, _MOST_SHARE)}

    def apply(self, state: FrameState) -> None:
        """Mix every pixel with the frames before, unless it has changed too much."""
        kept: Any = state.memory.kept.get(self.name)
        averages = self.window is not None
        past: Sequence[np.ndarray] = ()
        if kept is not None and kept[1] and kept[1][0].shape == state.measured.shape:
            # Outcomes of filters are not frames: only the first of either is the frame before.
            past = kept[1] if kept[0] == averages else kept[1][:1]
        with np.errstate(invalid='ignore'):
            if self.window is None:
                keep = self._mix(state, past)
            else:
                keep = self._average(state, past, self.window)
        state.memory.kept[self.name] = averages, keep

    def _mix(self, state: FrameState, past: Sequence[np.ndarray]) -> list[np.ndarray]:
        # Recursive; returns the outcome of each filter.
        kept = []
        shares: list[tuple[Any, ...]] = [self.rounded]
        if self.second is not None:
            shares.append((f32(min(self.strength * self.second, _MOST_SHARE)),))
        for place, share in enumerate(shares):
            if place < len(past):  # A second filter may be turned on while the camera runs.
                limit = state.sigma if self.gate is None else f32(self.gate) * state.sigma
                mix = filtered if self.gate is None else filtered_within
                state.measured = on_images(mix)(state.measured, past[place], limit, *share)
            kept.append(state.measured.copy())
        return kept

    def _average(
        self, state: FrameState, past: Sequence[np.ndarray], window: float
    ) -> list[np.ndarray]:
        # Mean of this frame and those before that are near it; returns frames as they came.
        new = state.measured
        limit = (_RESET_SIGMAS if self.gate is None else f32(self.gate)) * state.sigma
        total, weights = new.copy(), np.ones_like(new)
        for age, old in enumerate(past, start=1):
            weight = f32(min(self.strength, 1.0) * min(max(window - age, 0.0), 1.0))
            near = weight * (np.abs(old - new) < limit)
            total += np.where(near > 0, near * old, f32(0))
            weights += near
        state.measured = total / weights
        return [new.copy(), *past][: math.ceil(window) - 1]

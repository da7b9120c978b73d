"""Motion dropout: raw frames that see two surfaces."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.moving import find_motion
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.surface import PAD
import numpy as np


@dataclass(frozen=True)
class MotionDropout(Effect):
    """
    Raw frames that see two surfaces.

    A pixel is lost where an edge passes while the raw frames are taken; see `MotionArtefact`,
    which makes a depth of them instead.
    """

    name: ClassVar[str] = 'motion_dropout'
    stage: ClassVar[Stage] = Stage.DROPOUT
    order: ClassVar[int] = 4
    title: ClassVar[str] = 'raw frames that disagree: invalid pixels at moving edges'
    covariate: ClassVar[str] = 'time'
    changes: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = (
        'ifm O3D, documentation of its confidence image: moving edges become invalid; '
        'the size is assumed'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        grid('stretch', (1.0, 4.0), 0.0, 8.0, f'stamp at {stamp:g}', stamp_at=stamp)
        for stamp in (1.0, 0.5)
    )
    needs_motion: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'edges')
    family: ClassVar[str] = 'sequence of raw frames'
    picture: ClassVar[Picture] = Picture('moving', 'lost')
    stream: ClassVar[int] = 13
    batched: ClassVar[tuple[str, ...] | None] = ('motion', 'passing')

    stretch: float = parameter(1.0, 0.0, 20.0, '', 'factor on the duration of the raw frames')
    stamp_at: float = parameter(
        1.0, 0.0, 1.0, '', 'when in that time the stamp is: 0 at its beginning, 1 at its end'
    )
    step: float = parameter(0.05, 0.001, 5.0, 'm', 'difference of depth that is not accepted')

    def constants(self) -> dict[str, float]:
        """Return the factor on the raw frames' duration, when the stamp is, and the step."""
        return {
            'stretch': self.strength * self.stretch,
            'stamp_at': self.stamp_at,
            'step': self.step,
        }

    def apply(self, state: FrameState) -> None:
        """Lose the pixels that an edge passes between the first raw frame and the last."""
        stretch, stamp_at, step = self.constants().values()
        # Of the scene: lateral noise moves edges in `state.depth`.
        inverse = state.surface.inverse_depth[PAD:-PAD, PAD:-PAD]
        depth = np.divide(1, inverse, np.full_like(inverse, np.nan), where=inverse > 0)
        found = find_motion(state, depth, self, stretch, stamp_at)
        if found is None:
            return
        _, (*_, other, _, when) = found
        passes = (when != 1.0) & (np.abs(other - depth) > step)
        state.measured[passes] = np.nan

"""
Depth scale: a clock or a calibration that is wrong by a factor.

It looks like a pose error, wherever surfaces face the camera: the diagnosis looks for the factor
in all recordings first.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis, Searched, Term
from flexx2_sim_ros.physics.frame_state import FrameState, Stage


@dataclass(frozen=True)
class DepthScale(Effect):
    """A clock or a calibration that is wrong by a factor."""

    name: ClassVar[str] = 'depth_scale'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 15
    title: ClassVar[str] = 'wrong clock or calibration: a bias in proportion to distance'
    covariate: ClassVar[str] = 'distance'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    source: ClassVar[str] = (
        'pico flexx flight units of the space station read 1 to 12 % long (nasa/astrobee, '
        'astrobee/config/robots); not known for the Flexx2'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        # About sigma_z, as of an offset: features are linear up to there.
        Hypothesis('', (Term('factor', (1.001,), 0.8, 1.2, neutral=1.0),)),
    )
    searched: ClassVar[Searched | None] = Searched(
        'stretch',
        lambda found: (
            grid(
                'factor',
                tuple(1.0 + part * found[0] for part in (0.8, 1.0, 1.2)),
                0.8,
                1.2,
                f'about {1.0 + found[0]:.2f}',
                neutral=1.0,
            ),
        ),
    )
    smooth: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    like_a_pose: ClassVar[tuple[Mapping[str, float], ...]] = ({},)
    family: ClassVar[str] = 'constant'
    compared: ClassVar[str] = 'factor'
    batched: ClassVar[tuple[str, ...] | None] = ()

    factor: float = parameter(1.01, 0.8, 1.2, '', 'of every depth')

    def constants(self) -> dict[str, float]:
        """Return which part of each depth is added."""
        return {'part': self.strength * (self.factor - 1.0)}

    def apply(self, state: FrameState) -> None:
        """Scale the depth."""
        (part,) = self.rounded
        state.add_shift(part * state.depth)

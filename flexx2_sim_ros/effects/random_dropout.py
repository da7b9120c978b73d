"""Random dropout: pixels that are lost whatever they see, at random or always the same ones."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.losing import kept_by, lose
from flexx2_sim_ros.effects.tables import pixel_map, PixelMap
from flexx2_sim_ros.formulas.scalars import f32
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np

_ONE = f32(1.0)


def survives_chance(share: float) -> float:
    """Return the chance that a pixel stays valid where a fraction is lost at random."""
    return _ONE - share


@dataclass(frozen=True)
class RandomDropout(Effect):
    """Pixels that are lost whatever they see."""

    name: ClassVar[str] = 'random_dropout'
    stage: ClassVar[Stage] = Stage.DROPOUT
    order: ClassVar[int] = 3
    title: ClassVar[str] = 'lost data, failed checks or dead pixels: invalid whatever they see'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('validity',)
    source: ClassVar[str] = 'assumed: a loss that depends on nothing the camera sees'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (grid('share', (0.05, 0.3), 0.0, 0.95),)
    smooth: ClassVar[bool] = True
    family: ClassVar[str] = 'constant'
    compared: ClassVar[str] = 'share'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = ()
    batched: ClassVar[tuple[str, ...] | None] = ()

    share: float = parameter(
        0.01, 0.0, 1.0, '', 'fraction of the pixels that is lost, at strength 1'
    )

    dead: PixelMap | None = pixel_map(
        '', 0.0, 1.0, 'probability that each pixel is invalid, in place of share: dead pixels'
    )

    def constants(self) -> dict[str, float]:
        """Return the fraction of the pixels that is lost."""
        return {'share': min(self.strength * self.share, 1.0)}

    def apply(self, state: FrameState) -> None:
        """Lose pixels at random, or the same ones in every frame."""
        if self.dead is not None:
            lost = self.dead.of_image(state.depth.shape, f'{self.name}.dead')
            lose(state, kept_by(lost, self.strength), self.stream)
            return
        (share,) = self.rounded
        lose(state, np.full_like(state.depth, survives_chance(float(share))), self.stream)

"""Heavy tails: outliers now and then."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import where
from flexx2_sim_ros.physics.frame_state import FrameState, Stage


def with_tails(normal: float, chance: float, share: float, width: float) -> float:
    """Return a pixel's normal draw, wider where ``chance`` (0..1) is at most ``share``."""
    return where(chance <= share, normal * width, normal)


@dataclass(frozen=True)
class HeavyTails(Effect):
    """Outliers now and then."""

    name: ClassVar[str] = 'heavy_tails'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'occasional outliers: a fraction of the samples is much noisier'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('noise', 'outliers')
    source: ClassVar[str] = 'assumed: a fraction at 5 sigma'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('share', (0.005, 0.01, 0.02, 0.04), 0.0, 0.2),
    )
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'distribution of the noise'
    compared: ClassVar[str] = 'share'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('gross', ''),)
    picture: ClassVar[Picture] = Picture('histogram', 'frame')
    stream: ClassVar[int] = 4
    batched: ClassVar[tuple[str, ...] | None] = ('tails',)

    share: float = parameter(0.02, 0.0, 0.25, '', 'fraction of the samples, at strength 1')
    width: float = parameter(5.0, 1.0, 20.0, '', 'factor on the sigma of these samples')

    def constants(self) -> dict[str, float]:
        """Return the fraction of noisier samples and the factor on their sigma."""
        return {'share': self.strength * self.share, 'width': self.width}

    def apply(self, state: FrameState) -> None:
        """Widen some of the normals."""
        state.normals = on_images(with_tails)(
            state.normals, state.uniforms(self.stream), *self.rounded
        )

"""Effects on the noise: how much, how it is distributed, how edges move."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import STREAM_TAILS
import numpy as np

DARKEST = np.float32(1e-6)  # 1/m^2; the noise is beyond every range.


@dataclass(frozen=True)
class ExcessNoise(Effect):
    """More noise than the model says."""

    name: ClassVar[str] = 'excess_noise'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'sigma mis-fitted, or another surface: more axial noise everywhere'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('noise',)
    source: ClassVar[str] = 'design: the paper measured one white board'

    factor: float = parameter(1.3, 0.2, 5.0, '', 'on sigma_z, at strength 1')

    def apply(self, state: FrameState) -> None:
        """Scale sigma."""
        state.sigma = state.sigma * np.float32(max(1.0 + self.strength * (self.factor - 1.0), 0.0))


@dataclass(frozen=True)
class AmbientLight(Effect):
    """Shot noise of the background."""

    name: ClassVar[str] = 'ambient_light'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'shot noise of the background: noise that grows as the amplitude falls'
    covariate: ClassVar[str] = 'amplitude'
    changes: ClassVar[tuple[str, ...]] = ('noise',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'shot-noise statistics: sigma^2 + k^2 / A^2; magnitude is design'

    k: float = parameter(0.0008, 0.0, 0.1, '1/m', 'noise at unit amplitude')

    def apply(self, state: FrameState) -> None:
        """Add the variance."""
        extra = np.float32(self.strength * self.k) / np.maximum(state.signal, DARKEST)
        state.sigma = np.hypot(state.sigma, extra)


@dataclass(frozen=True)
class HeavyTails(Effect):
    """Outliers now and then."""

    name: ClassVar[str] = 'heavy_tails'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'outliers now and then: a share of the samples is much noisier'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('noise', 'outliers')
    source: ClassVar[str] = 'design: a share at 5 sigma'

    share: float = parameter(0.02, 0.0, 0.25, '', 'of the samples, at strength 1')
    width: float = parameter(5.0, 1.0, 20.0, '', 'factor on their sigma')

    def apply(self, state: FrameState) -> None:
        """Widen some of the normals."""
        wide = state.uniforms(STREAM_TAILS) <= np.float32(self.strength * self.share)
        state.normals = np.where(wide, state.normals * np.float32(self.width), state.normals)


@dataclass(frozen=True)
class LateralNoise(Effect):
    """Edges that move more, or otherwise."""

    name: ClassVar[str] = 'lateral_noise'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 3
    title: ClassVar[str] = 'edges that jitter more, or not as a Gaussian'
    covariate: ClassVar[str] = 'edge'
    changes: ClassVar[tuple[str, ...]] = ('edges',)
    source: ClassVar[str] = 'design: the paper says that lateral noise is not Gaussian'

    factor: float = parameter(1.5, 0.0, 5.0, '', 'on sigma_x, at strength 1')
    laplace: float = parameter(0.5, 0.0, 1.0, '', 'share of edges that move by a Laplacian')

    def edges(self, sigma: float) -> tuple[float, float]:
        """Return an edge's sigma (pixels) and the share of edges that are Laplacian."""
        return (
            sigma * max(1.0 + self.strength * (self.factor - 1.0), 0.0),
            min(self.strength, 1.0) * self.laplace,
        )

    def apply(self, state: FrameState) -> None:
        """Scale the edges' sigma and share them out."""
        state.edge_sigma, state.edge_laplace = self.edges(state.edge_sigma)

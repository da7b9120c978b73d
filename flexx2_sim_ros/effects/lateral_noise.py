"""Lateral noise: edges that move more, or otherwise."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, Stage


@dataclass(frozen=True)
class LateralNoise(Effect):
    """Edges that move more, or otherwise."""

    name: ClassVar[str] = 'lateral_noise'
    stage: ClassVar[Stage] = Stage.NOISE
    order: ClassVar[int] = 3
    title: ClassVar[str] = 'edges that jitter more, or with another distribution'
    covariate: ClassVar[str] = 'edge'
    changes: ClassVar[tuple[str, ...]] = ('edges',)
    source: ClassVar[str] = 'assumed; the paper says that lateral noise is not Gaussian'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('strength', (0.5, 1.0, 2.0), 0.0, 4.0, few=False),
    )
    # What edges that are known to a part of a pixel only may pretend.
    doubt: ClassVar[float] = 0.5
    nuisances: ClassVar[tuple[str, ...]] = ('edges', 'pose')
    family: ClassVar[str] = 'distribution of edges'
    compared: ClassVar[str] = 'factor'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('spread', 'edge'),)
    picture: ClassVar[Picture] = Picture('edge_positions')
    batched: ClassVar[tuple[str, ...] | None] = ('edges',)

    factor: float = parameter(1.5, 0.0, 5.0, '', 'factor on sigma_x, at strength 1')
    laplace: float = parameter(0.5, 0.0, 1.0, '', 'fraction of edges with Laplacian displacement')

    def edges(self, sigma: float) -> tuple[float, float]:
        """Return an edge's sigma (pixels) and the fraction of edges that are Laplacian."""
        return (
            sigma * max(1.0 + self.strength * (self.factor - 1.0), 0.0),
            min(self.strength, 1.0) * self.laplace,
        )

    def apply(self, state: FrameState) -> None:
        """Scale the edges' sigma, and set the fraction with Laplacian displacements."""
        state.edge_sigma, state.edge_laplace = self.edges(state.edge_sigma)

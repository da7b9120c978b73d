"""Ambient light: shot noise of the background."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np

DARKEST = np.float32(1e-6)  # 1/m^2; the noise is beyond every range.


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
    source: ClassVar[str] = 'shot-noise statistics: sigma^2 + k^2 / A^2; the magnitude is assumed'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('k', (0.0001, 0.0002, 0.0004, 0.0008, 0.0016), 0.0, 0.01),
    )
    brightness: ClassVar[float] = 0.3
    nuisances: ClassVar[tuple[str, ...]] = ('reflectivity', 'sigma')
    family: ClassVar[str] = 'function of amplitude'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('spread', 'amplitude'),)
    batched: ClassVar[tuple[str, ...] | None] = ()

    k: float = parameter(0.0008, 0.0, 0.1, '1/m', 'noise at unit amplitude')

    def apply(self, state: FrameState) -> None:
        """Add the variance."""
        extra = np.float32(self.strength * self.k) / np.maximum(state.signal, DARKEST)
        state.sigma = np.hypot(state.sigma, extra)

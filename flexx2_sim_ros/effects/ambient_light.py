"""Ambient light: shot noise of the background."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import f32, most, root
from flexx2_sim_ros.physics.frame_state import FrameState, Stage

_DARKEST = f32(1e-6)  # 1/m^2; the noise is beyond every range.


def with_shot_noise(sigma: float, amplitude: float, k: float) -> float:
    """Return sigma_z with the background's shot noise, which falls with the amplitude."""
    extra = k / most(amplitude, _DARKEST)
    return root(sigma * sigma + extra * extra)


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

    def constants(self) -> dict[str, float]:
        """Return the noise at unit amplitude, 1/m."""
        return {'k': self.strength * self.k}

    def apply(self, state: FrameState) -> None:
        """Add the variance."""
        state.sigma = on_images(with_shot_noise)(state.sigma, state.signal, *self.rounded)

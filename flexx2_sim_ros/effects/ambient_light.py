"""Ambient light: shot noise of the background, most of which the surfaces reflect."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.shapes import Free, Shape
from flexx2_sim_ros.formulas import on_images
from flexx2_sim_ros.formulas.scalars import f32, most, root
from flexx2_sim_ros.formulas.surfaces import usable_reflectivity
from flexx2_sim_ros.physics.frame_state import FrameState, Stage

_K = Free('k', 0.00005, 0.01, log=True)
_ONE = f32(1.0)
_DARKEST = f32(1e-6)  # 1/m^2; the noise is beyond every range.


def with_shot_noise(
    sigma: float, amplitude: float, reflectivity: float, k: float, reflected: float
) -> float:
    """
    Return sigma_z with the background's shot noise.

    It falls with the amplitude and grows with the square root of the background's light. Of that
    light the fraction ``reflected`` comes from the surface, in proportion to its reflectivity.
    """
    light = _ONE + reflected * (usable_reflectivity(reflectivity) - _ONE)
    extra = k * root(light) / most(amplitude, _DARKEST)
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
    source: ClassVar[str] = (
        'shot-noise statistics: sigma^2 + k^2 B / A^2, B the light of the background; assumed: '
        'the magnitude, and that surfaces reflect all of B'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('k', (0.0001, 0.0002, 0.0004, 0.0008, 0.0016), 0.0, 0.01),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('fraction that surfaces reflect', (_K, Free('reflected', 0.0, 1.0)), quick=True),
    )
    brightness: ClassVar[float] = 0.3
    nuisances: ClassVar[tuple[str, ...]] = ('reflectivity', 'sigma')
    family: ClassVar[str] = 'function of amplitude'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('spread', 'amplitude'),)
    batched: ClassVar[tuple[str, ...] | None] = ('sigma',)

    k: float = parameter(0.0008, 0.0, 0.1, '1/m', 'noise at unit amplitude on white surfaces')
    reflected: float = parameter(
        1.0, 0.0, 1.0, '', "fraction of the background's light that surfaces reflect"
    )

    def constants(self) -> dict[str, float]:
        """Return the noise at unit amplitude, 1/m, and the fraction that surfaces reflect."""
        return {'k': self.strength * self.k, 'reflected': self.reflected}

    def apply(self, state: FrameState) -> None:
        """Add the variance."""
        state.sigma = on_images(with_shot_noise)(
            state.sigma, state.signal, state.reflectivity, *self.rounded
        )

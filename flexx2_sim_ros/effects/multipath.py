"""Multipath: light that bounced once more."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.interreflection import bounce, with_bounce
from flexx2_sim_ros.effects.phasors import own_frequency, waves
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, MHZ, Shape
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.geometry import ray_length
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_with_bounce = compiled(with_bounce)
_GAIN = Free('gain', 0.1, 5.0, log=True)


@dataclass(frozen=True)
class Multipath(Effect):
    """Light that bounced once more."""

    name: ClassVar[str] = 'multipath'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'light that is reflected twice: positive bias in concave corners'
    covariate: ClassVar[str] = 'concavity'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'amplitude')
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'one diffuse bounce: Jimenez 2014, Bulczak 2018. The bias is zero at the '
        'corner, rises with the distance from it and falls again'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (grid('gain', (0.5, 1.0, 2.0), 0.0, 5.0),)
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('gain', (_GAIN,)),
        Shape('gain, one frequency', (_GAIN, MHZ)),
    )
    smooth: ClassVar[bool] = True
    brightness: ClassVar[float] = 0.25
    like_a_pose: ClassVar[tuple[Mapping[str, float], ...]] = ({},)
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'reflectivity')
    family: ClassVar[str] = 'indirect light'
    compared: ClassVar[str] = 'gain'
    picture: ClassVar[Picture] = Picture('along_row')
    batched: ClassVar[tuple[str, ...] | None] = ('bounce',)

    gain: float = parameter(1.0, 0.0, 5.0, '', 'factor on the physical strength of the bounce')
    mhz: float | None = own_frequency()

    def constants(self) -> dict[str, float]:
        """Return the factor on the physical strength of the bounce."""
        return {'gain': self.strength * self.gain}

    def apply(self, state: FrameState) -> None:
        """Add the indirect light's phasor; kept while the scene stands still."""
        scene = (state.depth, state.reflectivity)
        known = state.intrinsics, self.mhz
        parts = list(waves(state, self.mhz, None))
        kept: Any = state.memory.kept.get(self.name)
        if (
            kept is None
            or kept[0] != known
            or not all(
                one.shape == other.shape and np.array_equal(one, other, equal_nan=True)
                for one, other in zip(kept[1], scene, strict=True)
            )
        ):
            kept = (
                known,
                [image.copy() for image in scene],
                bounce(state, [wave.number for wave in parts]),
                ray_length(state.intrinsics.matrix, state.depth.shape),
            )
            state.memory.kept[self.name] = kept
        (factor,) = self.rounded
        brighter = np.zeros_like(state.amplitude)
        for wave, indirect in zip(parts, kept[2], strict=True):
            added = np.zeros_like(wave.shift)
            number, weight = np.float32(wave.number), np.float32(wave.weight)
            _add_bounce(indirect, factor, number, weight, kept[3], added, brighter)
            for shift in wave.shifts:
                shift += added
        state.amplitude = state.amplitude * brighter


@loop(error_model='numpy', fastmath=FAST)
def _add_bounce(indirect, factor, wave_number, weight, ray, shift, brighter):
    for y in range(shift.shape[0]):
        for x in range(shift.shape[1]):
            light = indirect[y, x]
            more, gain = _with_bounce(factor, light.real, light.imag, wave_number, ray[y, x])
            shift[y, x] += more
            brighter[y, x] += weight * gain

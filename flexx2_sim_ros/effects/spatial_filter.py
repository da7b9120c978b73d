"""Spatial filter: a bilateral filter in the camera."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas.scalars import f32, most, size, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np

_ZERO = f32(0.0)
_ONE = f32(1.0)


def is_alike(difference: float, limit: float) -> bool:
    """Say whether a neighbour at this difference of depth takes part; never true of NaN."""
    return size(difference) <= limit


def smoothed(here: float, differences: float, count: float, mix: float) -> float:
    """Return a depth mixed with the mean over ``count`` neighbours that are alike."""
    return where(count > _ZERO, here + mix * differences / most(count, _ONE), here)


@dataclass(frozen=True)
class SpatialFilter(Effect):
    """A bilateral filter in the camera."""

    name: ClassVar[str] = 'spatial_filter'
    stage: ClassVar[Stage] = Stage.FILTER
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'bilateral filter in the camera: less noise, correlated neighbours'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ('noise', 'neighbours')
    source: ClassVar[str] = 'Kinect v2: correlation of neighbours 0.6 to 0.7'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (grid('mix', (0.25, 0.5, 0.8, 1.0), 0.0, 1.0),)
    filters: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'filter over neighbours'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('beside', ''),)
    picture: ClassVar[Picture] = Picture('neighbours_alike')
    batched: ClassVar[tuple[str, ...] | None] = ('neighbours',)

    mix: float = parameter(0.9, 0.0, 1.0, '', 'weight of the 3 x 3 mean, at strength 1')
    gate: float = parameter(4.0, 0.5, 20.0, '', 'only neighbours within this many sigma_z count')

    def constants(self) -> dict[str, float]:
        """Return the gate, in sigma_z, and the weight of the mean."""
        return {'gate': self.gate, 'mix': min(self.strength * self.mix, 1.0)}

    def apply(self, state: FrameState) -> None:
        """Mix every pixel with those neighbours that are alike."""
        out = np.empty_like(state.measured)
        _gated_mean(state.measured, state.sigma, *self.rounded, out)
        state.measured = out


_is_alike = compiled(is_alike)
_smoothed = compiled(smoothed)


@loop(error_model='numpy', fastmath=FAST)
def _gated_mean(depth, sigma, gate, mix, out):
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            here = depth[y, x]
            limit = gate * sigma[y, x]
            total = np.float32(0.0)
            count = np.float32(0.0)
            for yy in range(max(y - 1, 0), min(y + 2, height)):
                for xx in range(max(x - 1, 0), min(x + 2, width)):
                    difference = depth[yy, xx] - here
                    if _is_alike(difference, limit):
                        total += difference
                        count += np.float32(1.0)
            out[y, x] = _smoothed(here, total, count, mix)

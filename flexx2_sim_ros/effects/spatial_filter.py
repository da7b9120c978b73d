"""Spatial filter: a bilateral filter in the camera."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.formulas.scalars import at, f32, most, size, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np
from numpy.typing import NDArray

_ZERO = f32(0.0)
_ONE = f32(1.0)


def mixed_with_alike(
    depth: NDArray[np.float32],
    first: int,
    height: int,
    width: int,
    y: int,
    x: int,
    limit: float,
    mix: float,
) -> float:
    """
    Return a pixel's depth mixed with the mean of those of the 3 x 3 pixels that are alike.

    Parameters
    ----------
    depth : numpy.ndarray
        Flat images, metres, NaN where invalid.
    first, height, width : int
        The image's first element, and its size.
    y, x : int
        The pixel.
    limit : float
        Pixels whose depths differ by at most this are alike, metres.
    mix : float
        Weight of the mean, 0..1.

    """
    here = at(depth, first + y * width + x)
    total = f32(0.0)
    count = f32(0.0)
    for k in range(9):
        yy = y + k // 3 - 1
        xx = x + k % 3 - 1
        if yy >= 0 and yy < height and xx >= 0 and xx < width:
            difference = at(depth, first + yy * width + xx) - here
            if size(difference) <= limit:  # never true of NaN
                total += difference
                count += _ONE
    return where(count > _ZERO, here + mix * total / most(count, _ONE), here)


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
        _filter(state.measured.ravel(), state.sigma, *self.rounded, out)
        state.measured = out


_mixed_with_alike = compiled(mixed_with_alike)


@loop(error_model='numpy', fastmath=FAST)
def _filter(depth, sigma, gate, mix, out):
    height, width = out.shape
    for y in range(height):
        for x in range(width):
            limit = gate * sigma[y, x]
            out[y, x] = _mixed_with_alike(depth, 0, height, width, y, x, limit, mix)

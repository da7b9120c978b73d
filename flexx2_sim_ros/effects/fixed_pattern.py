"""Fixed pattern: a delay of each pixel's own."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.tables import pixel_map, PixelMap
from flexx2_sim_ros.formulas.scalars import at, f32, f64, i32, least, most, root, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import fill_normals
import numpy as np
from numpy.typing import NDArray

AROUND = 2  # The mean that is taken off is over 5 x 5 pixels.
_PIXELS_AROUND = f32((2 * AROUND + 1) ** 2)
_LEAST_VARIANCE = f64(1e-12)
_ONE = f64(1.0)


def mirrored(i: int, size: int, smallest: int) -> int:
    """
    Return an index at most two beyond 0..size - 1 as one within it, mirrored at the end.

    ``smallest`` is the image's smaller side; in tiny images an index beyond the end is the end.
    """
    inside = least(most(i, i32(0)), size - 1)
    beyond = where(i < 0, -i, where(i >= size, 2 * (size - 1) - i, i))
    return where(smallest > AROUND, beyond, inside)


def less_mean(
    white: NDArray[np.float32], first: int, height: int, width: int, y: int, x: int
) -> float:
    """
    Return the noise of pixel (y, x) less the mean over the 5 x 5 pixels around it.

    ``white`` are flat images; this one begins at element ``first``.
    """
    smallest = least(height, width)
    total = f32(0.0)
    for k in range(y - AROUND, y + AROUND + 1):
        row = first + mirrored(k, height, smallest) * width
        for j in range(x - AROUND, x + AROUND + 1):
            total += at(white, row + mirrored(j, width, smallest))
    return at(white, first + y * width + x) - total / _PIXELS_AROUND


def to_unit_variance(total: np.float64, squares: np.float64, pixels: np.float64) -> np.float64:
    """
    Return the factor that gives noise unit variance; 1 if it has none.

    It takes the sum of the noise and of its squares over so many `pixels`.
    """
    mean = total / pixels
    variance = squares / pixels - mean * mean
    varies = variance > _LEAST_VARIANCE
    return where(varies, _ONE / root(where(varies, variance, _ONE)), _ONE)


_less_mean = compiled(less_mean)


@dataclass(frozen=True)
class FixedPattern(Effect):
    """A delay of each pixel's own."""

    name: ClassVar[str] = 'fixed_pattern'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 11
    title: ClassVar[str] = 'a delay of each pixel: the same fixed-pattern noise in every scene'
    covariate: ClassVar[str] = 'image'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'Azure Kinect: 0.9 mm, correlation 0.87 between two captures; 1-5 mm usual'
    )
    keeps: ClassVar[bool] = True
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('rms', (0.0008, 0.0015, 0.003), 0.0, 0.02, few=False),
    )
    repeats: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'map of the image'
    compared: ClassVar[str] = 'rms'
    picture: ClassVar[Picture] = Picture('two_scenes')
    stream: ClassVar[int] = 3
    batched: ClassVar[tuple[str, ...] | None] = ('shift', 'grain')

    rms: float = parameter(0.0015, 0.0, 0.1, 'm', 'root mean square over the pixels')

    pattern: PixelMap | None = pixel_map(
        'm', -0.2, 0.2, 'added to the depth of each pixel, in place of a random pattern'
    )

    def constants(self) -> dict[str, float]:
        """Return the root mean square over the pixels, metres."""
        return {'rms': self.strength * self.rms}

    def apply(self, state: FrameState) -> None:
        """Add the camera's pattern: the map, or one made once from its key."""
        if self.pattern is not None:
            values = self.pattern.of_image(state.depth.shape, f'{self.name}.pattern')
            state.add_shift(np.float32(self.strength) * values)
            return
        pattern = state.memory.kept.get(self.name)
        if pattern is None or pattern.shape != state.depth.shape:
            pattern = _grain(state.key.tobytes(), state.depth.shape)
            state.memory.kept[self.name] = pattern
        state.add_shift(self.rounded[0] * pattern)


@lru_cache(maxsize=8)  # Environments of one camera share it.
def _grain(key: bytes, shape: tuple[int, ...]) -> np.ndarray:
    # White noise less its mean over 5 x 5 pixels, scaled to unit variance.
    grain = np.empty(shape, np.float32)
    white = np.empty(grain.size, np.float32)
    zero = np.uint32(0)
    fill_normals(np.frombuffer(key, np.uint32).copy(), zero, zero, FixedPattern.stream, white)
    _less_its_mean(white, grain)
    wide = grain.astype(np.float64)
    scale = to_unit_variance(wide.sum(), np.square(wide).sum(), np.float64(wide.size))
    return grain * np.float32(scale)


@loop()
def _less_its_mean(white, grain):
    height, width = grain.shape
    for y in range(height):
        for x in range(width):
            grain[y, x] = _less_mean(white, 0, height, width, y, x)

"""Spatial filter: a bilateral filter in the camera."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, Shape
from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.formulas.scalars import at, f32, most, size, where
from flexx2_sim_ros.physics.compiled import compiled, inlined, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
import numpy as np
from numpy.typing import NDArray

_ZERO = f32(0.0)
_ONE = f32(1.0)
_GATE = Free('gate', 0.5, 20.0, log=True)
_REACH = 2.5  # of a Gaussian mean, standard deviations


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
    Return the depth of pixel (y, x) mixed with the mean of the 3 x 3 pixels that are alike.

    ``depth`` are flat images, metres, NaN where invalid; this one begins at element ``first``.
    Alike are depths that differ by at most ``limit``, metres. ``mix`` is the mean's weight, 0..1.
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
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('mix', (0.25, 0.5, 0.8, 1.0), 0.0, 1.0),
        *(
            grid('mix', (0.5, 1.0), 0.0, 1.0, f'over {width:g} px', width=width, gate=20.0)
            for width in (1.0, 2.5)
        ),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('3 x 3 mean', (Free('mix', 0.0, 1.0), _GATE), quick=True),
        Shape('3 x 3 median', (Free('mix', 0.0, 1.0),), {'median': 3.0, 'gate': 20.0}, quick=True),
        Shape('Gaussian mean', (Free('width', 0.2, 3.0, log=True), _GATE), {'mix': 1.0}),
    )
    filters: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('sigma',)
    family: ClassVar[str] = 'filter over neighbours'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('beside', ''),)
    picture: ClassVar[Picture] = Picture('neighbours_alike')
    batched: ClassVar[tuple[str, ...] | None] = ('neighbours',)

    mix: float = parameter(0.9, 0.0, 1.0, '', 'weight of the 3 x 3 mean, at strength 1')
    gate: float = parameter(4.0, 0.5, 20.0, '', 'only neighbours within this many sigma_z count')
    width: float | None = optional_number(
        'px', 0.05, 5.0, 'standard deviation of a Gaussian mean, in place of that of 3 x 3 pixels'
    )
    median: float | None = optional_number(
        'px', 3.0, 9.0, 'width of a median in place of a mean, rounded up to an odd number'
    )

    def constants(self) -> dict[str, float]:
        """Return the gate, in sigma_z, and the weight of the mean."""
        return {'gate': self.gate, 'mix': min(self.strength * self.mix, 1.0)}

    def apply(self, state: FrameState) -> None:
        """Mix every pixel with those neighbours that are alike."""
        out = np.empty_like(state.measured)
        if self.median is not None:
            reach = int(np.ceil((self.median - 1) / 2))
            _filter_by_median(state.measured, state.sigma, reach, *self.rounded, out)
        elif self.width is None:
            _filter(state.measured.ravel(), state.sigma, *self.rounded, out)
        else:
            places = np.arange(-int(np.ceil(_REACH * self.width)), 0)
            half = np.exp(-0.5 * (places / self.width) ** 2)
            line = np.concatenate([half, [1.0], half[::-1]]).astype(np.float32)
            _filter_widely(state.measured, state.sigma, line, *self.rounded, out)
        state.measured = out


_mixed_with_alike = compiled(mixed_with_alike)


@loop(error_model='numpy', fastmath=FAST)
def _filter(depth, sigma, gate, mix, out):
    height, width = out.shape
    for y in range(height):
        for x in range(width):
            limit = gate * sigma[y, x]
            out[y, x] = _mixed_with_alike(depth, 0, height, width, y, x, limit, mix)


@loop(error_model='numpy', fastmath=FAST)
def _filter_by_median(depth, sigma, reach, gate, mix, out):
    height, width = out.shape
    sorted_ = np.empty((2 * reach + 1) ** 2, np.float32)
    for y in range(height):
        for x in range(width):
            count = 0
            for yy in range(max(y - reach, 0), min(y + reach + 1, height)):
                for xx in range(max(x - reach, 0), min(x + reach + 1, width)):
                    difference = depth[yy, xx] - depth[y, x]
                    if abs(difference) <= gate * sigma[y, x]:  # never true of NaN
                        place = count
                        while place > 0 and sorted_[place - 1] > difference:
                            sorted_[place] = sorted_[place - 1]
                            place -= 1
                        sorted_[place] = difference
                        count += 1
            middle = (sorted_[(count - 1) // 2] + sorted_[count // 2]) / np.float32(2.0)
            out[y, x] = depth[y, x] + mix * middle if count > 0 else depth[y, x]


@inlined
def _add_alike(there, here, limits, weight, totals, weights):
    for x in range(here.size):
        difference = there[x] - here[x]
        alike = abs(difference) <= limits[x]  # never true of NaN
        own = weight if alike else np.float32(0.0)
        totals[x] += own * (difference if alike else np.float32(0.0))
        weights[x] += own


@loop(error_model='numpy', fastmath=FAST)
def _filter_widely(depth, sigma, line, gate, mix, out):
    # Weights are products of `line`, from the farthest pixel before to the farthest after.
    # One shift of the image after the other: a row is vector code then.
    height, width = out.shape
    reach = line.size // 2
    limits, totals, weights = np.empty((3, width), np.float32)
    for y in range(height):
        here = depth[y]
        for x in range(width):
            limits[x] = gate * sigma[y, x]
            totals[x] = weights[x] = np.float32(0.0)
        for yy in range(max(y - reach, 0), min(y + reach + 1, height)):
            for shift in range(-reach, reach + 1):
                weight = line[yy - y + reach] * line[shift + reach]
                first, last = max(-shift, 0), min(width - shift, width)
                if first < last:
                    _add_alike(
                        depth[yy, first + shift : last + shift],
                        here[first:last],
                        limits[first:last],
                        weight,
                        totals[first:last],
                        weights[first:last],
                    )
        for x in range(width):
            mean = totals[x] / weights[x]
            out[y, x] = here[x] + mix * mean if weights[x] > 0 else here[x]

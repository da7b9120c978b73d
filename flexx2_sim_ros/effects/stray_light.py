"""Stray light: scatter in the lens."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.phasors import frequency_factor, own_frequency, waves
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, MHZ, Shape
from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.formulas.scalars import f32, i32, least, most
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np
import scipy  # its parts are imported on use

BLOCK = 4  # A wide kernel is applied to the image at a quarter of its resolution.
_BLOCK_PIXELS = f32(BLOCK)
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)


def block_before(pixel: int, blocks: int) -> tuple[int, float]:
    """Return the block before a pixel of a line, and the pixel's way to the next one, 0..1."""
    last = f32(blocks - i32(1))
    place = least(most((f32(pixel) + _HALF) / _BLOCK_PIXELS - _HALF, _ZERO), last)
    before = i32(place)
    return before, place - f32(before)


def mixed(first: float, second: float, share: float) -> float:
    """Return what is between two values, ``share`` of the way from the first to the second."""
    return (_ONE - share) * first + share * second


_SHARE = Free('share', 0.001, 0.2, log=True)
_RADIUS = Free('radius', 0.003, 0.5, log=True)
_EXPONENT = Free('exponent', 1.05, 3.0)
_block_before = compiled(block_before)
_mixed = compiled(mixed)


@dataclass(frozen=True)
class StrayLight(Effect):
    """Scatter in the lens."""

    name: ClassVar[str] = 'stray_light'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 2
    title: ClassVar[str] = (
        'scatter in the lens: dark and far surfaces shift towards bright and near ones'
    )
    covariate: ClassVar[str] = 'amplitude'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'amplitude')
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'Schaefer 2014: 0.5 to 5 % of the light'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        *(
            grid('share', (0.02,), 0.0, 0.15, f'width {width:g}', width=width)
            for width in (0.04, 0.1, 0.25, 1.0)
        ),
        *(
            grid(
                'share',
                (0.02,),
                0.0,
                0.15,
                f'width {width:g} at {mhz:g} MHz',
                width=width,
                mhz=mhz,
            )
            for width in (0.04, 0.1, 1.0)
            for mhz in (32.0, 60.0)
        ),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('wide kernel', (_SHARE, Free('width', 0.02, 1.0, log=True))),
        Shape('kernel of free width', (_SHARE, _RADIUS, _EXPONENT), {'frequency_factor': 1.0}),
        Shape('kernel of free width at one frequency', (_SHARE, _RADIUS, _EXPONENT, MHZ)),
    )
    smooth: ClassVar[bool] = True
    brightness: ClassVar[float] = 0.1
    like_a_pose: ClassVar[tuple[Mapping[str, float], ...]] = ({},)
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose', 'reflectivity')
    family: ClassVar[str] = 'kernel over the image'
    compared: ClassVar[str] = 'share'
    picture: ClassVar[Picture] = Picture(at_chart=True)
    batched: ClassVar[tuple[str, ...] | None] = ('scatter',)

    share: float = parameter(
        0.02, 0.0, 0.2, '', 'fraction of the light that is scattered, at strength 1'
    )
    width: float = parameter(0.15, 0.02, 1.0, '', 'half-value radius, fraction of the image width')
    radius: float | None = optional_number(
        '',
        0.002,
        1.0,
        'half-value radius of a kernel at full resolution, fraction of the image width, in place '
        'of width',
    )
    exponent: float | None = optional_number(
        '', 1.02, 6.0, 'with radius: of the kernel (1 + (r / w)^2)^-exponent; without, 1.5'
    )
    mhz: float | None = own_frequency()
    frequency_factor: float | None = frequency_factor()

    def constants(self) -> dict[str, float]:
        """Return the fraction of the light that is scattered."""
        return {'share': self.strength * self.share}

    def apply(self, state: FrameState) -> None:
        """Add the scattered phasor."""
        (share,) = self.rounded
        amplitude = np.zeros_like(state.amplitude)
        for wave in waves(state, self.mhz, self.frequency_factor):
            direction = wave.directions()
            light = state.amplitude * direction
            if self.radius is None:
                light += share * _scatter(light, self.width)
            else:
                light += share * _scatter_finely(light, self.radius, self.exponent or 1.5)
            wave.turn(direction.reshape(-1), light.reshape(-1))
            amplitude += np.float32(wave.weight) * np.abs(light)
        state.amplitude = np.where(np.isfinite(state.depth), amplitude, np.float32(0))


def spread_of(rows: int, columns: int, radius: float, exponent: float = 1.5) -> np.ndarray:
    """
    Return how light spreads from one block to all others, (2 * rows, 2 * columns) float64.

    It is (1 + r^2 / w^2)^-exponent with sum 1; ``radius`` is where half of the peak is left, in
    blocks. Rows and columns beyond the middle are distances to the other side.
    """
    w2 = radius**2 / (2.0 ** (1.0 / exponent) - 1.0)
    y = np.minimum(np.arange(2 * rows), 2 * rows - np.arange(2 * rows))
    x = np.minimum(np.arange(2 * columns), 2 * columns - np.arange(2 * columns))
    kernel: np.ndarray = (1.0 + (y[:, None] ** 2 + x[None, :] ** 2) / w2) ** -exponent
    return kernel / kernel.sum()


def _scatter(image: np.ndarray, width: float) -> np.ndarray:
    # Convolve with a wide kernel of unit sum, on coarse blocks; nothing comes from outside.
    height, wide = image.shape
    rows, columns = -(-height // BLOCK), -(-wide // BLOCK)
    blocks = np.zeros((rows, columns), np.complex64)
    _gather(image, blocks)
    spectrum = np.fft.fft2(blocks, s=(2 * rows, 2 * columns)) * _spectrum(
        rows, columns, width * wide / BLOCK
    )
    coarse = np.fft.ifft2(spectrum)[:rows, :columns].astype(np.complex64)
    out = np.empty_like(image)
    _interpolate(coarse, out)
    return out


def _scatter_finely(image: np.ndarray, width: float, exponent: float) -> np.ndarray:
    # The same at full resolution, for kernels as narrow as a few pixels.
    height, wide = image.shape
    shape = 2 * height, 2 * wide
    spectrum = scipy.fft.fft2(image, s=shape) * _spectrum(height, wide, width * wide, exponent)
    return np.asarray(scipy.fft.ifft2(spectrum)[:height, :wide])


@lru_cache(maxsize=16)
def _spectrum(rows: int, columns: int, radius: float, exponent: float = 1.5) -> np.ndarray:
    return np.fft.fft2(spread_of(rows, columns, radius, exponent)).astype(np.complex64)


@loop()
def _gather(image, blocks):
    # Light of a block, as if it were a pixel's.
    share = np.float32(1.0 / BLOCK**2)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            blocks[y // BLOCK, x // BLOCK] += share * image[y, x]


@loop()
def _interpolate(blocks, out):
    # Linearly, from the blocks' centres to pixels.
    rows, columns = blocks.shape
    for y in range(out.shape[0]):
        top, down = _block_before(np.int32(y), np.int32(rows))
        low = min(top + 1, rows - 1)
        for x in range(out.shape[1]):
            left, right = _block_before(np.int32(x), np.int32(columns))
            other = min(left + 1, columns - 1)
            above = _mixed(blocks[top, left], blocks[top, other], right)
            below = _mixed(blocks[low, left], blocks[low, other], right)
            out[y, x] = _mixed(above, below, down)

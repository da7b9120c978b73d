"""Effects that mix the light of several surfaces in one pixel."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from flexx2_sim_ros.camera.exposure import Exposure, Stage
from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.interreflection import bounce
from numba import njit
import numpy as np

_COARSE = 4  # A wide kernel is applied to the image at a quarter of its resolution.


def _phasor(exposure: Exposure, wave_number: float, shift: np.ndarray) -> np.ndarray:
    # Amplitude and phase as a complex number, 0 where nothing is.
    phase = np.float32(wave_number) * np.nan_to_num(exposure.depth + shift)
    out = np.empty(phase.shape, np.complex64)
    np.multiply(exposure.amplitude, np.cos(phase), out=out.real)
    np.multiply(exposure.amplitude, np.sin(phase), out=out.imag)
    return out


def _turn(shift: np.ndarray, wave_number: float, before: np.ndarray, after: np.ndarray,
          where: np.ndarray | slice = slice(None)) -> None:
    # Shift depth by what the phase has turned.
    turned = after * before.conj()
    shift[where] += np.arctan2(turned.imag, turned.real) / np.float32(wave_number)


@dataclass(frozen=True)
class FlyingPixels(Effect):
    """Footprints that span an edge."""

    name: ClassVar[str] = 'flying_pixels'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'footprints that span an edge: values between foreground and background'
    covariate: ClassVar[str] = 'edge'
    source: ClassVar[str] = 'phasor mixing over the footprint; share is design'

    share: float = parameter(0.3, 0.0, 1.0, '', 'of the light that comes from the 3 x 3 pixels '
                             'around, at strength 1')

    def apply(self, exposure: Exposure) -> None:
        """Mix the phasors of neighbours, next to depth jumps."""
        near = np.flatnonzero(_near_jumps(exposure.surface.row_jumps,
                                          exposure.surface.column_jumps, exposure.amplitude))
        if not near.size:
            return
        share = np.float32(min(self.strength * self.share, 1.0))
        amplitude = np.zeros(near.size, np.float32)
        for k, weight, shift in zip(exposure.wave_numbers, exposure.weights, exposure.shifts,
                                    strict=True):
            light = _phasor(exposure, k, shift)
            before = light.ravel()[near]
            around = np.empty_like(before)
            _mean_around(light, exposure.amplitude, near, around)
            after = (np.float32(1) - share) * before + share * around
            _turn(shift.reshape(-1), k, before, after, near)
            amplitude += np.float32(weight) * np.abs(after)
        exposure.amplitude.reshape(-1)[near] = amplitude


@njit(cache=True)
def _near_jumps(row_jumps, column_jumps, amplitude):  # type: ignore[no-untyped-def]
    # Lit pixels whose 3 x 3 neighbourhood has a depth jump in it.
    height, width = amplitude.shape
    near = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            if row_jumps[y, x] or column_jumps[y, x]:
                for yy in range(max(y - 1, 0), min(y + 3, height)):
                    for xx in range(max(x - 1, 0), min(x + 3, width)):
                        near[yy, xx] |= amplitude[yy, xx] > 0
    return near


@njit(cache=True)
def _mean_around(light, amplitude, pixels, out):  # type: ignore[no-untyped-def]
    # Mean phasor of the lit ones of 3 x 3 pixels.
    height, width = light.shape
    for n in range(pixels.size):
        y, x = pixels[n] // width, pixels[n] % width
        total = np.complex64(0)
        count = 0
        for yy in range(max(y - 1, 0), min(y + 2, height)):
            for xx in range(max(x - 1, 0), min(x + 2, width)):
                total += light[yy, xx]
                count += amplitude[yy, xx] > 0
        out[n] = total / np.float32(count)


@dataclass(frozen=True)
class Multipath(Effect):
    """Light that bounced once more."""

    name: ClassVar[str] = 'multipath'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'light that bounced once more: positive bias in concave corners'
    covariate: ClassVar[str] = 'image'
    source: ClassVar[str] = 'one diffuse bounce: Jimenez 2014, Bulczak 2018'
    keeps: ClassVar[bool] = True

    gain: float = parameter(1.0, 0.0, 5.0, '', 'factor on the physical bounce')

    def apply(self, exposure: Exposure) -> None:
        """Add the indirect light's phasor; kept while the scene stands still."""
        kept = exposure.memory.kept.get(self.name)
        if kept is None or not all(
                one.shape == other.shape and np.array_equal(one, other, equal_nan=True)
                for one, other in zip(kept[0], (exposure.depth, exposure.reflectivity),
                                      strict=True)):
            scene = (exposure.depth.copy(), exposure.reflectivity.copy())
            kept = (scene, bounce(exposure))
            exposure.memory.kept[self.name] = kept
        factor = np.float32(self.strength * self.gain)
        for k, shift, indirect in zip(exposure.wave_numbers, exposure.shifts, kept[1],
                                      strict=True):
            shift += np.arctan2(factor * indirect.imag,
                                np.float32(1) + factor * indirect.real) / np.float32(k)


@dataclass(frozen=True)
class StrayLight(Effect):
    """Scatter in the lens."""

    name: ClassVar[str] = 'stray_light'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'scatter in the lens: dark and far pulled towards bright and near'
    covariate: ClassVar[str] = 'amplitude'
    source: ClassVar[str] = 'Schaefer 2014: 0.5 to 5 % of the light'

    share: float = parameter(0.02, 0.0, 0.2, '', 'of the light that is scattered, at strength 1')
    width: float = parameter(0.15, 0.02, 1.0, '', 'half-value radius, share of the width')

    def apply(self, exposure: Exposure) -> None:
        """Add the scattered phasor."""
        share = np.float32(self.strength * self.share)
        lit = exposure.amplitude > 0
        amplitude = np.zeros_like(exposure.amplitude)
        for k, weight, shift in zip(exposure.wave_numbers, exposure.weights, exposure.shifts,
                                    strict=True):
            before = _phasor(exposure, k, shift)
            after = before + share * _scatter(before, self.width)
            _turn(shift, k, before, after)
            amplitude += np.float32(weight) * np.abs(after)
        exposure.amplitude = np.where(lit, amplitude, exposure.amplitude)


def _scatter(image: np.ndarray, width: float) -> np.ndarray:
    # Convolve with a wide kernel of unit sum, on coarse blocks; nothing comes from outside.
    height, wide = image.shape
    rows, columns = -(-height // _COARSE), -(-wide // _COARSE)
    padded = np.zeros((rows * _COARSE, columns * _COARSE), np.complex64)
    padded[:height, :wide] = image
    blocks = padded.reshape(rows, _COARSE, columns, _COARSE).mean(axis=(1, 3))
    spectrum = np.fft.fft2(blocks, s=(2 * rows, 2 * columns)) * _kernel(
        rows, columns, width * wide / _COARSE)
    coarse = np.fft.ifft2(spectrum)[:rows, :columns].astype(np.complex64)
    return _interpolation(height, rows) @ coarse @ _interpolation(wide, columns).T


@lru_cache(maxsize=16)
def _kernel(rows: int, columns: int, radius: float) -> np.ndarray:
    # Spectrum of (1 + r^2 / w^2)^(-3/2), half its peak at r = radius, on a doubled grid.
    w2 = radius ** 2 / (2.0 ** (2.0 / 3.0) - 1.0)
    y = np.minimum(np.arange(2 * rows), 2 * rows - np.arange(2 * rows))
    x = np.minimum(np.arange(2 * columns), 2 * columns - np.arange(2 * columns))
    kernel = (1.0 + (y[:, None] ** 2 + x[None, :] ** 2) / w2) ** -1.5
    return np.fft.fft2(kernel / kernel.sum()).astype(np.complex64)


@lru_cache(maxsize=16)
def _interpolation(size: int, blocks: int) -> np.ndarray:
    # (size, blocks) float32: linear interpolation from block centres to pixels.
    position = np.clip((np.arange(size) + 0.5) / _COARSE - 0.5, 0, blocks - 1)
    low = np.minimum(position.astype(int), max(blocks - 2, 0))
    share = position - low
    matrix = np.zeros((size, blocks), np.float32)
    matrix[np.arange(size), low] = 1.0 - share
    if blocks > 1:
        matrix[np.arange(size), low + 1] += share.astype(np.float32)
    return matrix

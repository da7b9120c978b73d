"""Effects that mix the light of several surfaces in one pixel."""

from dataclasses import dataclass
from functools import lru_cache
import math
from typing import Any, ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.interreflection import bounce
from flexx2_sim_ros.physics.fastmath import arctan2, cos_sin_turns
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import FAST
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from numba import njit
import numpy as np

_COARSE = 4  # A wide kernel is applied to the image at a quarter of its resolution.


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _directions(depth, shift, turns, out):  # type: ignore[no-untyped-def]
    # What a pixel's phase is, as a complex number of magnitude 1; 0 where nothing is. `turns`: of
    # phase a metre.
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            phase = turns * (depth[y, x] + shift[y, x])
            phase = phase - np.floor(phase)
            cosine, sine = cos_sin_turns(phase if phase == phase else np.float32(0.0))
            out[y, x] = complex(cosine, sine) if depth[y, x] > 0 else complex(0.0, 0.0)


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _turn(before, after, wave_number, shift):  # type: ignore[no-untyped-def]
    # Shift depth by what the phase has turned. All flat.
    for i in range(before.size):
        turned = after[i] * before[i].conjugate()
        shift[i] += arctan2(turned.imag, turned.real) / wave_number


def _phases(state: FrameState, wave_number: float, shift: np.ndarray) -> np.ndarray:
    out = np.empty(state.depth.shape, np.complex64)
    _directions(state.depth, shift, np.float32(wave_number / (2.0 * math.pi)), out)
    return out


@dataclass(frozen=True)
class FlyingPixels(Effect):
    """Footprints that span an edge."""

    name: ClassVar[str] = 'flying_pixels'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'footprints that span an edge: values between foreground and background'
    covariate: ClassVar[str] = 'edge'
    changes: ClassVar[tuple[str, ...]] = ('edges',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'phasor mixing over the footprint; share is design'
    needs_modulation: ClassVar[bool] = True

    share: float = parameter(
        0.3, 0.0, 1.0, '', 'of the light that comes from the 3 x 3 pixels around, at strength 1'
    )

    def apply(self, state: FrameState) -> None:
        """Mix the phasors of neighbours, next to depth jumps."""
        surface = state.surface
        near = np.flatnonzero(_near_jumps(surface.row_jumps, surface.column_jumps))
        near = near[np.isfinite(state.depth.reshape(-1)[near])]
        if not near.size:
            return
        share = np.float32(min(self.strength * self.share, 1.0))
        amplitude = np.zeros(near.size, np.float32)
        for k, weight, shift in zip(state.wave_numbers, state.weights, state.shifts, strict=True):
            direction = _phases(state, k, shift)
            mixed = np.empty(near.size, np.complex64)
            _mix_around(state.amplitude * direction, direction, near, share, mixed)
            turned = np.zeros(near.size, np.float32)
            _turn(direction.reshape(-1)[near], mixed, np.float32(k), turned)
            shift.reshape(-1)[near] += turned
            amplitude += np.float32(weight) * np.abs(mixed)
        state.amplitude.reshape(-1)[near] = amplitude


@njit(cache=True)
def _near_jumps(row_jumps, column_jumps):  # type: ignore[no-untyped-def]
    # Pixels whose 3 x 3 neighbourhood has a depth jump in it.
    height, width = row_jumps.shape
    near = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            if row_jumps[y, x]:
                near[max(y - 1, 0) : y + 2, x : x + 2] = True
            if column_jumps[y, x]:
                near[y : y + 2, max(x - 1, 0) : x + 2] = True
    return near


@njit(cache=True)
def _mix_around(light, direction, pixels, share, out):  # type: ignore[no-untyped-def]
    # (1 - share) of a pixel's own light and `share` of the mean of the 3 x 3 around it, as far as
    # there is something.
    height, width = light.shape
    for n in range(pixels.size):
        y, x = pixels[n] // width, pixels[n] % width
        total = np.complex64(0)
        count = 0
        for yy in range(max(y - 1, 0), min(y + 2, height)):
            for xx in range(max(x - 1, 0), min(x + 2, width)):
                total += light[yy, xx]
                count += direction[yy, xx] != 0
        own = light[y, x]
        out[n] = own + share * (total / np.float32(count) - own)


@dataclass(frozen=True)
class Multipath(Effect):
    """Light that bounced once more."""

    name: ClassVar[str] = 'multipath'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 1
    title: ClassVar[str] = 'light that bounced once more: positive bias in concave corners'
    covariate: ClassVar[str] = 'image'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'amplitude')
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'one diffuse bounce: Jimenez 2014, Bulczak 2018. Rises with the '
        'distance from the apex, where the detour is nil, and falls again'
    )
    keeps: ClassVar[bool] = True
    needs_modulation: ClassVar[bool] = True

    gain: float = parameter(1.0, 0.0, 5.0, '', 'factor on the physical bounce')

    def apply(self, state: FrameState) -> None:
        """Add the indirect light's phasor; kept while the scene stands still."""
        scene = (state.depth, state.reflectivity)
        kept: Any = state.memory.kept.get(self.name)
        if (
            kept is None
            or kept[0] != state.intrinsics
            or not all(
                one.shape == other.shape and np.array_equal(one, other, equal_nan=True)
                for one, other in zip(kept[1], scene, strict=True)
            )
        ):
            kept = (
                state.intrinsics,
                [image.copy() for image in scene],
                bounce(state),
                _depth_of_range(state.intrinsics),
            )
            state.memory.kept[self.name] = kept
        factor = np.float32(self.strength * self.gain)
        brighter = np.zeros_like(state.amplitude)
        for k, weight, shift, indirect in zip(
            state.wave_numbers, state.weights, state.shifts, kept[2], strict=True
        ):
            _add_bounce(
                indirect, factor, np.float32(k), np.float32(weight), kept[3], shift, brighter
            )
        state.amplitude = state.amplitude * brighter


def _depth_of_range(camera: Intrinsics) -> np.ndarray:
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    cosine: np.ndarray = (1.0 + x**2 + y[:, None] ** 2) ** -0.5
    return cosine.astype(np.float32)


@njit(cache=True, error_model='numpy', fastmath=FAST)
def _add_bounce(  # type: ignore[no-untyped-def]
    indirect, factor, wave_number, weight, depth_of_range, shift, brighter
):
    # The detour is along the ray.
    for y in range(shift.shape[0]):
        for x in range(shift.shape[1]):
            real = np.float32(1.0) + factor * indirect[y, x].real
            imaginary = factor * indirect[y, x].imag
            shift[y, x] += arctan2(imaginary, real) / wave_number * depth_of_range[y, x]
            brighter[y, x] += weight * math.sqrt(real * real + imaginary * imaginary)


@dataclass(frozen=True)
class StrayLight(Effect):
    """Scatter in the lens."""

    name: ClassVar[str] = 'stray_light'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 2
    title: ClassVar[str] = 'scatter in the lens: dark and far pulled towards bright and near'
    covariate: ClassVar[str] = 'amplitude'
    changes: ClassVar[tuple[str, ...]] = ('bias', 'amplitude')
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'Schaefer 2014: 0.5 to 5 % of the light'
    needs_modulation: ClassVar[bool] = True

    share: float = parameter(0.02, 0.0, 0.2, '', 'of the light that is scattered, at strength 1')
    width: float = parameter(0.15, 0.02, 1.0, '', 'half-value radius, share of the width')

    def apply(self, state: FrameState) -> None:
        """Add the scattered phasor."""
        share = np.float32(self.strength * self.share)
        amplitude = np.zeros_like(state.amplitude)
        for k, weight, shift in zip(state.wave_numbers, state.weights, state.shifts, strict=True):
            direction = _phases(state, k, shift)
            light = state.amplitude * direction
            light += share * _scatter(light, self.width)
            _turn(direction.reshape(-1), light.reshape(-1), np.float32(k), shift.reshape(-1))
            amplitude += np.float32(weight) * np.abs(light)
        state.amplitude = np.where(np.isfinite(state.depth), amplitude, np.float32(0))


def _scatter(image: np.ndarray, width: float) -> np.ndarray:
    # Convolve with a wide kernel of unit sum, on coarse blocks; nothing comes from outside.
    height, wide = image.shape
    rows, columns = -(-height // _COARSE), -(-wide // _COARSE)
    blocks = np.zeros((rows, columns), np.complex64)
    _gather(image, blocks)
    spectrum = np.fft.fft2(blocks, s=(2 * rows, 2 * columns)) * _kernel(
        rows, columns, width * wide / _COARSE
    )
    coarse = np.fft.ifft2(spectrum)[:rows, :columns].astype(np.complex64)
    out = np.empty_like(image)
    _interpolate(coarse, out)
    return out


@njit(cache=True)
def _gather(image, blocks):  # type: ignore[no-untyped-def]
    # Light of a block, as if it were a pixel's.
    share = np.float32(1.0 / _COARSE**2)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            blocks[y // _COARSE, x // _COARSE] += share * image[y, x]


@njit(cache=True)
def _interpolate(blocks, out):  # type: ignore[no-untyped-def]
    # Linearly, from the blocks' centres to pixels.
    rows, columns = blocks.shape
    half, one, size = np.float32(0.5), np.float32(1.0), np.float32(_COARSE)
    for y in range(out.shape[0]):
        down = min(
            max((np.float32(y) + half) / size - half, np.float32(0.0)), np.float32(rows - 1)
        )
        top = int(down)
        low = min(top + 1, rows - 1)
        sy = down - np.float32(top)
        for x in range(out.shape[1]):
            across = min(
                max((np.float32(x) + half) / size - half, np.float32(0.0)), np.float32(columns - 1)
            )
            left = int(across)
            right = min(left + 1, columns - 1)
            sx = across - np.float32(left)
            above = (one - sx) * blocks[top, left] + sx * blocks[top, right]
            below = (one - sx) * blocks[low, left] + sx * blocks[low, right]
            out[y, x] = (one - sy) * above + sy * below


@lru_cache(maxsize=16)
def _kernel(rows: int, columns: int, radius: float) -> np.ndarray:
    # Spectrum of (1 + r^2 / w^2)^(-3/2), half its peak at r = radius, on a doubled grid.
    w2 = radius**2 / (2.0 ** (2.0 / 3.0) - 1.0)
    y = np.minimum(np.arange(2 * rows), 2 * rows - np.arange(2 * rows))
    x = np.minimum(np.arange(2 * columns), 2 * columns - np.arange(2 * columns))
    kernel = (1.0 + (y[:, None] ** 2 + x[None, :] ** 2) / w2) ** -1.5
    return np.fft.fft2(kernel / kernel.sum()).astype(np.complex64)

"""
The effect stray_light in a batch, one frequency after the other; see `effects.stray_light`.

The kernel over the image is a sum of products of a function of the row and one of the column
(`products`): light spreads along the rows first, then along the columns.
"""

from collections.abc import Sequence
from functools import lru_cache

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import TURN
from flexx2_sim_ros.batch.frame import Frame, of_pixels, OPTIONS, Own, padded, place, Scatter
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.effects import stray_light
from flexx2_sim_ros.effects.stray_light import BLOCK, spread_of
from flexx2_sim_ros.formulas import fastmath
import numpy as np
import warp as wp

wp.set_module_options(OPTIONS)

# Of the scattered light, where its kernel is a sum of few products: float32 holds no more.
_KERNEL_ERROR = 1e-6
_BLOCK = wp.constant(BLOCK)
_OF_BLOCK = wp.constant(wp.float32(1.0 / BLOCK**2))

_block_before = compiled(stray_light.block_before)
_mixed = compiled(stray_light.mixed)
_direction = compiled(fastmath.direction)
_shift_between = compiled(fastmath.shift_between)


@wp.func
def _scatters(f: Frame, own: Own) -> wp.bool:
    return f.scatter.kinds[own.env] >= 0 and f.frequency < own.light.frequencies


@wp.func
def kind_of(f: Frame, n: wp.int32) -> wp.int32:
    """Return which kernel of light an environment has at the frequency at hand; -1 for none."""
    env = f.first + n
    return wp.where(f.frequency < f.lights[env].frequencies, f.scatter.kinds[env], -1)


@of_pixels(when=_scatters)
def find_directions(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the phase of each pixel as a complex number of magnitude 1; 0 without a return."""
    i = place(f.lens, n, y, x)
    inverse = at(f.surfaces.p, padded(f.lens, n, y, x))
    there = wp.where(inverse > 0.0, 1.0, 0.0)
    z = 1.0 / wp.where(inverse > 0.0, inverse, 1.0)
    shift = at(f.shifts, f.frequency * f.pitch + i)
    cosine, sine = _direction(own.turns * (z + shift))
    put(f.scatter.directions, i, there * cosine)
    put(f.scatter.directions, f.pitch + i, there * sine)


@wp.kernel
def sum_blocks(f: Frame):
    """Write the light of a block, as if it were a pixel's."""
    n, row, column = wp.tid()
    if kind_of(f, n) < 0:
        return
    scatter = f.scatter
    real = wp.float32(0.0)
    imaginary = wp.float32(0.0)
    y = row * _BLOCK
    while y < wp.min((row + 1) * _BLOCK, f.lens.height):
        pixel = place(f.lens, n, y, 0)
        x = column * _BLOCK
        while x < wp.min((column + 1) * _BLOCK, f.lens.width):
            amplitude = at(f.amplitude, pixel + x)
            real += amplitude * at(scatter.directions, pixel + x)
            imaginary += amplitude * at(scatter.directions, f.pitch + pixel + x)
            x += 1
        y += 1
    block = (n * scatter.rows + row) * scatter.columns + column
    put(scatter.blocks, block, real * _OF_BLOCK)
    put(scatter.blocks, scatter.size + block, imaginary * _OF_BLOCK)


@wp.kernel
def spread_across(f: Frame):
    """Spread light along the rows, for each term of the kernel."""
    n, row, column = wp.tid()
    kind = kind_of(f, n)
    if kind < 0:
        return
    scatter = f.scatter
    columns = scatter.columns
    source = (n * scatter.rows + row) * columns
    target = (n * columns + column) * scatter.terms * scatter.rows + row
    term = wp.int32(0)
    while term < scatter.terms:
        # What is at distance -column, ..., columns - 1 - column.
        weights = (kind * scatter.terms + term) * (2 * columns - 1) + columns - 1 - column
        real = wp.float32(0.0)
        imaginary = wp.float32(0.0)
        i = wp.int32(0)
        while i < columns:
            weight = at(scatter.across, weights + i)
            real += weight * at(scatter.blocks, source + i)
            imaginary += weight * at(scatter.blocks, scatter.size + source + i)
            i += 1
        put(scatter.spread, target + term * scatter.rows, real)
        put(scatter.spread, scatter.terms * scatter.size + target + term * scatter.rows, imaginary)
        term += 1


@wp.kernel
def spread_down(f: Frame):
    """Spread light along the columns, and add the kernel's terms."""
    n, column, row = wp.tid()  # Neighbouring threads read the same light.
    kind = kind_of(f, n)
    if kind < 0:
        return
    scatter = f.scatter
    rows = scatter.rows
    source = (n * scatter.columns + column) * scatter.terms * rows
    real = wp.float32(0.0)
    imaginary = wp.float32(0.0)
    term = wp.int32(0)
    while term < scatter.terms:
        weights = (kind * scatter.terms + term) * (2 * rows - 1) + rows - 1 - row
        i = wp.int32(0)
        while i < rows:
            weight = at(scatter.down, weights + i)
            real += weight * at(scatter.spread, source + i)
            imaginary += weight * at(scatter.spread, scatter.terms * scatter.size + source + i)
            i += 1
        source += rows
        term += 1
    block = (n * rows + row) * scatter.columns + column
    put(scatter.scattered, block, real)
    put(scatter.scattered, scatter.size + block, imaginary)


@wp.func
def between_blocks(f: Frame, i: wp.int32, x: wp.int32) -> wp.float32:
    """Return the scattered light at a pixel of the block row that begins at ``i``."""
    columns = f.scatter.columns
    left, share = _block_before(x, columns)
    right = wp.min(left + 1, columns - 1)
    return _mixed(at(f.scatter.scattered, i + left), at(f.scatter.scattered, i + right), share)


@wp.kernel
def widen(f: Frame):
    """Write the scattered light of each pixel of a block row, linearly between the blocks."""
    n, row, c = wp.tid()
    if kind_of(f, n) < 0:
        return
    scatter = f.scatter
    width = f.lens.width
    source = (n * scatter.rows + row) * scatter.columns
    target = (n * scatter.rows + row) * width
    other_target = scatter.envs * scatter.rows * width + target
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, width)
    stride = stride_of(width)
    while x < end:
        put(scatter.wide, target + x, between_blocks(f, source, x))
        put(scatter.wide, other_target + x, between_blocks(f, scatter.size + source, x))
        x += stride


@of_pixels(when=_scatters)
def add_scattered(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Add the scattered light to each pixel, linearly between the block rows."""
    scatter = f.scatter
    width = f.lens.width
    k = f.frequency
    i = place(f.lens, n, y, x)
    top, down = _block_before(y, scatter.rows)
    above = (n * scatter.rows + top) * width + x
    below = (n * scatter.rows + wp.min(top + 1, scatter.rows - 1)) * width + x
    other_wide = scatter.envs * scatter.rows * width
    amplitude = at(f.amplitude, i)
    cosine = at(scatter.directions, i)
    sine = at(scatter.directions, f.pitch + i)
    share = own.effects.stray_light_share
    real = amplitude * cosine + share * _mixed(
        at(scatter.wide, above), at(scatter.wide, below), down
    )
    imaginary = amplitude * sine + share * _mixed(
        at(scatter.wide, other_wide + above), at(scatter.wide, other_wide + below), down
    )
    more = _shift_between(real, imaginary, cosine, sine, TURN * own.turns)
    put(f.shifts, k * f.pitch + i, at(f.shifts, k * f.pitch + i) + more)
    # Where there is no return, there is no amplitude either.
    there = wp.where(cosine * cosine + sine * sine > 0.0, own.weight, 0.0)
    before = wp.where(k == 0, 0.0, at(f.total, i))
    total = before + there * wp.sqrt(real * real + imaginary * imaginary)
    put(f.total, i, total)
    if k == own.light.frequencies - 1:
        put(f.amplitude, i, total)


class ScatteredLight:
    """
    How light spreads over the environments' images.

    `widths` are the kernel's width in each environment, see `StrayLight`; None where the effect is
    off. `frequencies` is the most modulation frequencies of a mode.
    """

    def __init__(self, widths: Sequence[float | None], frequencies: int, images: Images) -> None:
        """Put the kernels on the device, and allocate the images of a pass."""
        self._images, self._frequencies, device = images, frequencies, images.device
        rows, columns = -(-images.height // BLOCK), -(-images.width // BLOCK)
        different = sorted({width for width in widths if width is not None})
        kinds: dict[float | None, int] = {width: i for i, width in enumerate(different)}
        kernels = [products(rows, columns, width * images.width / BLOCK) for width in different]
        scatter = Scatter()
        scatter.rows, scatter.columns, scatter.envs = rows, columns, images.most
        scatter.size = images.most * rows * columns
        scatter.kinds = wp.array(
            [kinds.get(width, -1) for width in widths], dtype=wp.int32, device=device
        )
        scatter.terms = terms = max(len(down) for down, _ in kernels)
        scatter.down, scatter.across = (
            wp.array(_both_ways(parts, terms).ravel(), dtype=wp.float32, device=device)
            for parts in zip(*kernels, strict=True)
        )
        pixels, blocks = images.height * images.width, rows * columns
        scatter.directions, scatter.wide, scatter.blocks, scatter.scattered, scatter.spread = (
            wp.zeros(2 * images.most * size, dtype=wp.float32, device=device)
            for size in (pixels, rows * images.width, blocks, blocks, terms * blocks)
        )
        images.frame.scatter = scatter
        wp.load_module(__name__, device=device)

    def add(self) -> None:
        """Add the scattered light to the pixels of the pass."""
        images, frame = self._images, self._images.frame
        count, rows, columns = images.count, frame.scatter.rows, frame.scatter.columns
        for frequency in range(self._frequencies):
            frame.frequency = frequency
            images.each_pixel(find_directions)
            launch(sum_blocks, (count, rows, columns), frame)
            launch(spread_across, (count, rows, columns), frame)
            launch(spread_down, (count, columns, rows), frame)
            launch(widen, (count, rows, images.grid(1)[2]), frame)
            images.each_pixel(add_scattered)


@lru_cache(maxsize=4096)
def products(rows: int, columns: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the kernel of `spread_of` as a sum of products, (R, rows) and (R, columns) float64.

    They are functions of the distance along the column and along the row. Their products add up to
    the kernel, to 1e-6 of its sum. R is 3 to 13 for images of 224 x 172: the kernel is smooth.
    """
    wanted = spread_of(rows, columns, radius)[:rows, :columns]
    left, sizes, right = np.linalg.svd(wanted, full_matrices=False)
    down, across = left.T * sizes[:, None], right
    missing = wanted
    for terms in range(1, sizes.size + 1):
        missing = missing - np.outer(down[terms - 1], across[terms - 1])
        if 4 * np.abs(missing).sum() <= _KERNEL_ERROR:
            break
    return down[:terms], across[:terms]


def _both_ways(parts: Sequence[np.ndarray], terms: int) -> np.ndarray:
    # (kernels, terms, 2 * size - 1): distances from -(size - 1) to size - 1.
    size = parts[0].shape[1]
    out = np.zeros((len(parts), terms, 2 * size - 1), np.float32)
    distances = np.abs(np.arange(1 - size, size))
    for both, part in zip(out, parts, strict=True):
        both[: len(part)] = part[:, distances]
    return out

"""
The effect stray_light as Warp kernels, one frequency after the other; see `effects.stray_light`.

The kernel over the image is a sum of products of a function of the row and one of the column
(`batch.light`): light spreads along the rows first, then along the columns.
"""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import TURN
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import Lens, OPTIONS, padded
from flexx2_sim_ros.batch.light_kernels import Phasors
from flexx2_sim_ros.effects import stray_light
from flexx2_sim_ros.effects.stray_light import BLOCK
from flexx2_sim_ros.formulas import phases
import warp as wp

wp.set_module_options(OPTIONS)

_BLOCK = wp.constant(BLOCK)
_OF_BLOCK = wp.constant(wp.float32(1.0 / BLOCK**2))

_block_before = compiled(stray_light.block_before)
_mixed = compiled(stray_light.mixed)
_direction = compiled(phases.direction)
_shift_between = compiled(phases.shift_between)


@wp.struct
class Scatter:
    """How light spreads, and the images of a pass: all real parts, then all imaginary ones."""

    kinds: wp.array(dtype=wp.int32)  # of each environment, which kernel; -1 for none
    across: wp.array(dtype=wp.float32)  # by kernel and term: for -(columns - 1)..columns - 1
    down: wp.array(dtype=wp.float32)  # by kernel and term: for -(rows - 1)..rows - 1
    terms: wp.int32
    rows: wp.int32
    columns: wp.int32
    envs: wp.int32  # in a pass
    directions: wp.array(dtype=wp.float32)  # the phase of each pixel
    blocks: wp.array(dtype=wp.float32)  # light by block
    spread: wp.array(dtype=wp.float32)  # by block column, term and block row
    scattered: wp.array(dtype=wp.float32)  # by block
    wide: wp.array(dtype=wp.float32)  # the same between blocks, for each pixel of a block row


@wp.kernel
def find_directions(
    surfaces_p: wp.array(dtype=wp.float32),
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    f: wp.int32,
    lights: wp.array(dtype=Light),
    phasors: Phasors,
    scatter: Scatter,
):
    """Write the phase of each pixel as a complex number of magnitude 1; 0 without a return."""
    n, y, c = wp.tid()
    light = lights[first + n]
    if scatter.kinds[first + n] < 0 or f >= light.frequencies:
        return
    turns = light.turns[f]
    row = (n * lens.height + y) * lens.width
    imaginary = scatter.envs * lens.height * lens.width
    i = padded(lens, n, y, 0)
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        inverse = at(surfaces_p, i + x)
        there = wp.where(inverse > 0.0, 1.0, 0.0)
        z = 1.0 / wp.where(inverse > 0.0, inverse, 1.0)
        cosine, sine = _direction(turns * (z + at(phasors.shifts, f * phasors.pitch + row + x)))
        put(scatter.directions, row + x, there * cosine)
        put(scatter.directions, imaginary + row + x, there * sine)
        x += stride


@wp.kernel
def sum_blocks(
    lens: Lens,
    first: wp.int32,
    f: wp.int32,
    lights: wp.array(dtype=Light),
    phasors: Phasors,
    scatter: Scatter,
):
    """Write the light of a block, as if it were a pixel's."""
    n, row, column = wp.tid()
    if scatter.kinds[first + n] < 0 or f >= lights[first + n].frequencies:
        return
    imaginary_part = scatter.envs * lens.height * lens.width
    real = wp.float32(0.0)
    imaginary = wp.float32(0.0)
    y = row * _BLOCK
    while y < wp.min((row + 1) * _BLOCK, lens.height):
        pixel = (n * lens.height + y) * lens.width
        x = column * _BLOCK
        while x < wp.min((column + 1) * _BLOCK, lens.width):
            amplitude = at(phasors.amplitude, pixel + x)
            real += amplitude * at(scatter.directions, pixel + x)
            imaginary += amplitude * at(scatter.directions, imaginary_part + pixel + x)
            x += 1
        y += 1
    block = (n * scatter.rows + row) * scatter.columns + column
    put(scatter.blocks, block, real * _OF_BLOCK)
    put(
        scatter.blocks,
        scatter.envs * scatter.rows * scatter.columns + block,
        imaginary * _OF_BLOCK,
    )


@wp.kernel
def spread_across(first: wp.int32, f: wp.int32, lights: wp.array(dtype=Light), scatter: Scatter):
    """Spread light along the rows, for each term of the kernel."""
    n, row, column = wp.tid()
    kind = scatter.kinds[first + n]
    if kind < 0 or f >= lights[first + n].frequencies:
        return
    columns = scatter.columns
    blocks = scatter.rows * columns
    source = n * blocks + row * columns
    other_part = scatter.envs * blocks
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
            imaginary += weight * at(scatter.blocks, other_part + source + i)
            i += 1
        put(scatter.spread, target + term * scatter.rows, real)
        put(scatter.spread, scatter.terms * other_part + target + term * scatter.rows, imaginary)
        term += 1


@wp.kernel
def spread_down(first: wp.int32, f: wp.int32, lights: wp.array(dtype=Light), scatter: Scatter):
    """Spread light along the columns, and add the kernel's terms."""
    n, column, row = wp.tid()  # Neighbouring threads read the same light.
    kind = scatter.kinds[first + n]
    if kind < 0 or f >= lights[first + n].frequencies:
        return
    rows = scatter.rows
    blocks = rows * scatter.columns
    other_part = scatter.envs * blocks
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
            imaginary += weight * at(scatter.spread, scatter.terms * other_part + source + i)
            i += 1
        source += rows
        term += 1
    put(scatter.scattered, n * blocks + row * scatter.columns + column, real)
    put(scatter.scattered, other_part + n * blocks + row * scatter.columns + column, imaginary)


@wp.kernel
def widen(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    f: wp.int32,
    lights: wp.array(dtype=Light),
    scatter: Scatter,
):
    """Write the scattered light of each pixel of a block row, linearly between the blocks."""
    n, row, c = wp.tid()
    if scatter.kinds[first + n] < 0 or f >= lights[first + n].frequencies:
        return
    columns = scatter.columns
    source = (n * scatter.rows + row) * columns
    target = (n * scatter.rows + row) * lens.width
    other_source = scatter.envs * scatter.rows * columns
    other_target = scatter.envs * scatter.rows * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        left, share = _block_before(x, columns)
        a = source + left
        b = source + wp.min(left + 1, columns - 1)
        put(
            scatter.wide,
            target + x,
            _mixed(at(scatter.scattered, a), at(scatter.scattered, b), share),
        )
        put(
            scatter.wide,
            other_target + target + x,
            _mixed(
                at(scatter.scattered, other_source + a),
                at(scatter.scattered, other_source + b),
                share,
            ),
        )
        x += stride


@wp.kernel
def add_scattered(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    f: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    phasors: Phasors,
    scatter: Scatter,
):
    """Add the scattered light to each pixel, linearly between the block rows."""
    n, y, c = wp.tid()
    light = lights[first + n]
    if scatter.kinds[first + n] < 0 or f >= light.frequencies:
        return
    share = effects[first + n].stray_light_share
    wave_number = TURN * light.turns[f]
    weight = light.weights[f]
    other_part = scatter.envs * lens.height * lens.width
    other_wide = scatter.envs * scatter.rows * lens.width
    top, down = _block_before(y, scatter.rows)
    above = (n * scatter.rows + top) * lens.width
    below = (n * scatter.rows + wp.min(top + 1, scatter.rows - 1)) * lens.width
    row = (n * lens.height + y) * lens.width
    shift = f * phasors.pitch + row
    start = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    x = wp.int32(start)
    while x < end:
        amplitude = at(phasors.amplitude, row + x)
        cosine = at(scatter.directions, row + x)
        sine = at(scatter.directions, other_part + row + x)
        real = amplitude * cosine + share * _mixed(
            at(scatter.wide, above + x), at(scatter.wide, below + x), down
        )
        imaginary = amplitude * sine + share * _mixed(
            at(scatter.wide, other_wide + above + x),
            at(scatter.wide, other_wide + below + x),
            down,
        )
        more = _shift_between(real, imaginary, cosine, sine, wave_number)
        put(phasors.shifts, shift + x, at(phasors.shifts, shift + x) + more)
        # Where there is no return, there is no amplitude either.
        there = wp.where(cosine * cosine + sine * sine > 0.0, weight, 0.0)
        before = wp.where(f == 0, 0.0, at(phasors.total, row + x))
        total = before + there * wp.sqrt(real * real + imaginary * imaginary)
        put(phasors.total, row + x, total)
        x += stride
    if f == light.frequencies - 1:
        x = wp.int32(start)
        while x < end:
            put(phasors.amplitude, row + x, at(phasors.total, row + x))
            x += stride

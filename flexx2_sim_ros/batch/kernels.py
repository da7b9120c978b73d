"""
The base model as Warp kernels: one source for CPU and CUDA.

Images are flat: frame after frame, row after row. Inverse depth (0 without a return) and jumps
have a border of `PAD` zeros on each side, so that no pixel needs a case of its own. A thread
takes ``chunk`` pixels of a row: all of them on the CPU, where the loop becomes vector
instructions, a few on CUDA. `formulas.surfaces` explains the model; edges move in `edge_kernels`.
"""

from flexx2_sim_ros.batch.arithmetic import AXIAL, counter_of, four_normals, one_of
from flexx2_sim_ros.batch.arrays import at, at_byte, at_word, put, put_byte, put_word
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.formulas import pixels, surfaces
from flexx2_sim_ros.physics import surface
import warp as wp

# What physics.philox.FAST allows there: all but assuming that there is no NaN and no infinity.
OPTIONS = {
    'enable_backward': False,
    'fast_math': True,
    'default_grid_stride': False,  # on CUDA
    'cpu_compiler_flags': f'{wp.config.cpu_compiler_flags or "-march=native"} -ffp-contract=fast '
    '-mreassociate -freciprocal-math -fno-signed-zeros -fapprox-func',
}
wp.set_module_options(OPTIONS)

PAD = wp.constant(surface.PAD)
BORDER = wp.constant(2 * surface.PAD)
_NEAREST = wp.constant(wp.float32(surface.NEAREST))
_FARTHEST = wp.constant(wp.float32(surface.FARTHEST))
_ROW = wp.constant(wp.uint8(1))
_COLUMN = wp.constant(wp.uint8(2))
_NONE = wp.constant(wp.uint8(0))
_STILL = wp.constant(wp.uint16(0))

_is_jump = compiled(surfaces.is_jump)
_slope_between = compiled(surfaces.slope_between)
_cos_incidence = compiled(surfaces.cos_incidence)
_sigma_of_surface = compiled(surfaces.sigma_of_surface)
_inverse_depth = compiled(surfaces.inverse_depth)
_is_seen = compiled(pixels.is_seen)
distance = compiled(surfaces.distance)


@wp.struct
class Lens:
    """What is the same for all environments: the camera matrix and the model's constants."""

    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    height: wp.int32
    width: wp.int32
    jump_share: wp.float32
    steep_share: wp.float32
    cap: wp.float32
    neighbourhood: wp.int32
    invalid: wp.float32


@wp.struct
class Noise:
    """What depends on an environment's mode."""

    a: wp.float32
    b: wp.float32
    c: wp.float32
    d: wp.float32
    n: wp.float32
    range_min: wp.float32
    range_max: wp.float32
    edge_sigma: wp.float32
    edge_laplace: wp.float32
    edge_limit: wp.int32


@wp.func
def padded(lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.int32:
    """Return where a pixel is in an image with a border."""
    return (n * (lens.height + BORDER) + y + PAD) * (lens.width + BORDER) + x + PAD


@wp.kernel
def invert(
    depth: wp.array(dtype=wp.float32),
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    p: wp.array(dtype=wp.float32),
    moved_pixels: wp.array(dtype=wp.int32),
):
    """Write inverse depth; 0 where depth is not a distance."""
    n, y, c = wp.tid()
    if y == 0 and c == 0:
        moved_pixels[n] = 0
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    source = ((first + n) * lens.height + y) * lens.width
    target = padded(lens, n, y, 0)
    while x < end:
        put(p, target + x, _inverse_depth(at(depth, source + x), _NEAREST, _FARTHEST))
        x += 1


@wp.kernel
def find_jumps(
    p: wp.array(dtype=wp.float32), lens: Lens, chunk: wp.int32, jumps: wp.array(dtype=wp.uint8)
):
    """Flag the depth jumps to the right of (1) and below (2) every pixel."""
    n, y, c = wp.tid()
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    pitch = lens.width + BORDER
    row = padded(lens, n, y, 0)
    last = lens.width - 1
    below = wp.where(y < lens.height - 1, _COLUMN, _NONE)
    while x < end:
        i = row + x
        here = at(p, i)
        across = _is_jump(
            at(p, i - 1), here, at(p, i + 1), at(p, i + 2), lens.jump_share, lens.steep_share
        )
        down = _is_jump(
            at(p, i - pitch),
            here,
            at(p, i + pitch),
            at(p, i + 2 * pitch),
            lens.jump_share,
            lens.steep_share,
        )
        put_byte(
            jumps, i, (wp.where(across and x < last, _ROW, _NONE) | wp.where(down, below, _NONE))
        )
        x += 1


@wp.func
def slopes(
    p: wp.array(dtype=wp.float32), jumps: wp.array(dtype=wp.uint8), lens: Lens, i: wp.int32
) -> wp.vec2f:
    """Return the slopes of inverse depth along the row and the column, 1/m a pixel."""
    pitch = lens.width + BORDER
    here = at(p, i)
    left = at(p, i - 1)
    right = at(p, i + 1)
    above = at(p, i - pitch)
    below = at(p, i + pitch)
    own = at_byte(jumps, i)
    # Where a line ends there is nothing to take a slope to.
    du = _slope_between(
        at(p, i - 2),
        left,
        here,
        right,
        at(p, i + 2),
        left <= 0.0 or (at_byte(jumps, i - 1) & _ROW) != _NONE,
        right <= 0.0 or (own & _ROW) != _NONE,
    )
    dv = _slope_between(
        at(p, i - 2 * pitch),
        above,
        here,
        below,
        at(p, i + 2 * pitch),
        above <= 0.0 or (at_byte(jumps, i - pitch) & _COLUMN) != _NONE,
        below <= 0.0 or (own & _COLUMN) != _NONE,
    )
    return wp.vec2f(du, dv)


@wp.func
def cos_incidence(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    i: wp.int32,
    y: wp.int32,
    x: wp.int32,
) -> wp.float32:
    """Return the cosine between a pixel's ray and its surface's normal; 1 without a return."""
    here = at(p, i)
    d = slopes(p, jumps, lens, i)
    u = wp.float32(x) - lens.cx
    v = wp.float32(y) - lens.cy
    return _cos_incidence(here, d[0], d[1], u, v, u / lens.fx, v / lens.fy, lens.fx, lens.fy)


@wp.func
def model_sigma(noise: Noise, lens: Lens, inverse: wp.float32, cosine: wp.float32) -> wp.float32:
    """Return sigma_z, metres; 0 without a return."""
    return _sigma_of_surface(
        inverse, cosine, noise.a, noise.b, noise.c, noise.d, noise.n, lens.cap
    )


@wp.kernel
def describe(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    noises: wp.array(dtype=Noise),
    cosine: wp.array(dtype=wp.float32),
    sigma: wp.array(dtype=wp.float32),
):
    """Write the cosine of the incidence angle and sigma_z of every pixel, for effects."""
    n, y, c = wp.tid()
    noise = noises[first + n]
    row = (n * lens.height + y) * lens.width
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        i = padded(lens, n, y, x)
        facing = cos_incidence(p, jumps, lens, i, y, x)
        put(cosine, row + x, facing)
        put(sigma, row + x, model_sigma(noise, lens, at(p, i), facing))
        x += 1


@wp.func
def noisy(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    noise: Noise,
    lens: Lens,
    n: wp.int32,
    y: wp.int32,
    x: wp.int32,
    normal: wp.float32,
) -> wp.float32:
    """Return what is seen of the surface at a pixel, with axial noise."""
    i = padded(lens, n, y, x)
    inverse = at(p, i)
    sigma = model_sigma(noise, lens, inverse, cos_incidence(p, jumps, lens, i, y, x))
    z = distance(inverse, 0.0)
    value = z + sigma * normal
    seen = _is_seen(z, value, noise.range_min, noise.range_max)
    return wp.where(seen, value, lens.invalid)


@wp.func
def blocks_of(pixels: wp.int32) -> wp.int32:
    """Return how many counters the pixels of a frame need."""
    return (pixels + 3) / 4


@wp.kernel
def draw_normals(
    pixels: wp.int32,
    first: wp.int32,
    chunk: wp.int32,
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    out: wp.array(dtype=wp.float32),
):
    """Write normals, ``chunk`` blocks of four a thread; ``out`` has room for whole blocks."""
    n, c = wp.tid()
    key = keys[first + n]
    stamp = stamps[first + n]
    blocks = blocks_of(pixels)
    base = n * 4 * blocks
    block = c * chunk
    end = wp.min(block + chunk, blocks)
    while block < end:
        four = four_normals(counter_of(block, AXIAL, stamp), key)
        i = base + 4 * block
        put(out, i, four[0])
        put(out, i + 1, four[1])
        put(out, i + 2, four[2])
        put(out, i + 3, four[3])
        block += 1


@wp.kernel
def observe_rows(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    noises: wp.array(dtype=Noise),
    normals: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Write a row of the frame, as if no edge had moved. For the CPU."""
    n, y = wp.tid()
    noise = noises[first + n]
    pixels = lens.height * lens.width
    row = y * lens.width
    drawn = n * blocks_of(pixels) * 4 + row
    target = (first + n) * pixels + row
    x = wp.int32(0)
    while x < lens.width:
        put(out, target + x, noisy(p, jumps, noise, lens, n, y, x, at(normals, drawn + x)))
        x += 1


@wp.kernel
def observe_blocks(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    noises: wp.array(dtype=Noise),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    out: wp.array(dtype=wp.float32),
):
    """Write four pixels that share a counter, as if no edge had moved. For CUDA."""
    n, block = wp.tid()
    noise = noises[first + n]
    pixels = lens.height * lens.width
    four = four_normals(counter_of(block, AXIAL, stamps[first + n]), keys[first + n])
    y = 4 * block / lens.width
    x = 4 * block - y * lens.width
    for k in range(4):
        if y < lens.height:
            put(
                out,
                (first + n) * pixels + 4 * block + k,
                noisy(p, jumps, noise, lens, n, y, x, four[k]),
            )
        x += 1
        if x == lens.width:
            x = 0
            y += 1


@wp.kernel
def observe_moved(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    threads: wp.int32,
    noises: wp.array(dtype=Noise),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    moved: wp.array(dtype=wp.uint16),
    moved_pixels: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float32),
):
    """Write again the few pixels that see another surface, and clear their entries."""
    n, thread = wp.tid()
    noise = noises[first + n]
    pixels = lens.height * lens.width
    entry = thread
    while entry < moved_pixels[n]:
        pixel = pixel_list[n * pixels + entry]
        code = wp.int32(at_word(moved, n * pixels + pixel))
        put_word(moved, n * pixels + pixel, _STILL)
        offset = (code & 255) - 128
        column = (code >> 8) & 1
        y = pixel / lens.width
        x = pixel - y * lens.width
        if offset != 0:
            four = four_normals(counter_of(pixel / 4, AXIAL, stamps[first + n]), keys[first + n])
            put(
                out,
                (first + n) * pixels + pixel,
                noisy(
                    p,
                    jumps,
                    noise,
                    lens,
                    n,
                    y + offset * column,
                    x + offset * (1 - column),
                    one_of(four, pixel % 4),
                ),
            )
        entry += threads

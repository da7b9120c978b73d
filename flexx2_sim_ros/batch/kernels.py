"""
The base model as Warp kernels: one source for CPU and CUDA.

Images are flat: frame after frame, row after row. Inverse depth (0 without a return) and jumps
have a border of `PAD` zeros on each side, so that no pixel needs a case of its own. A thread
takes ``chunk`` pixels of a row: all of them on the CPU, where the loop becomes vector
instructions, a few on CUDA. `formulas.surfaces` explains the model; edges move in `edge_kernels`.
"""

from flexx2_sim_ros.batch.arrays import (
    add_each,
    at,
    at_byte,
    at_word,
    end_of,
    first_of,
    put,
    put_byte,
    put_word,
    stride_of,
)
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.formulas import surfaces
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
# Counters are so far apart that those of two environments are not in one line of a cache.
SPREAD = wp.constant(32)
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
    listed: wp.array(dtype=wp.int32),
):
    """Write inverse depth, 0 where depth is not a distance; no pixel is listed."""
    n, y, c = wp.tid()
    if y == 0 and c == 0:
        listed[n * SPREAD] = 0
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    source = ((first + n) * lens.height + y) * lens.width
    target = padded(lens, n, y, 0)
    while x < end:
        put(p, target + x, _inverse_depth(at(depth, source + x), _NEAREST, _FARTHEST))
        x += stride


@wp.func
def jumps_at(
    p: wp.array(dtype=wp.float32), lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.uint8:
    """Return the depth jumps to the right of (1) and below (2) a pixel."""
    i = padded(lens, n, y, x)
    pitch = lens.width + BORDER
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
    below = wp.where(y < lens.height - 1, _COLUMN, _NONE)
    return wp.where(across and x < lens.width - 1, _ROW, _NONE) | wp.where(down, below, _NONE)


@wp.kernel
def find_jumps(
    p: wp.array(dtype=wp.float32), lens: Lens, chunk: wp.int32, jumps: wp.array(dtype=wp.uint8)
):
    """Flag the depth jumps of every pixel."""
    n, y, c = wp.tid()
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    row = padded(lens, n, y, 0)
    while x < end:
        put_byte(jumps, row + x, jumps_at(p, lens, n, y, x))
        x += stride


@wp.kernel
def list_jumps(
    p: wp.array(dtype=wp.float32),
    lens: Lens,
    chunk: wp.int32,
    jumps: wp.array(dtype=wp.uint8),
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Flag the depth jumps of every pixel, and list the pixels that have one. For CUDA."""
    n, y, c = wp.tid()
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    row = padded(lens, n, y, 0)
    found = wp.int32(0)
    bits = wp.int32(0)
    while x < end:
        jump = jumps_at(p, lens, n, y, x)
        put_byte(jumps, row + x, jump)
        bits = bits * 2
        if jump != _NONE:
            bits += 1
            found += 1
        x += stride
    add_to_list(lens, n, y * lens.width + x - stride, stride, bits, found, listed, pixel_list)


@wp.func
def add_to_list(
    lens: Lens,
    n: wp.int32,
    last: wp.int32,
    stride: wp.int32,
    bits: wp.int32,
    found: wp.int32,
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """List pixels of an environment of the pass: of every ``stride``, back from the last."""
    place = n * lens.height * lens.width + add_each(listed, n * SPREAD, found)
    pixel = wp.int32(last)
    left = wp.int32(bits)
    while left > 0:
        if left % 2 == 1:
            pixel_list[place] = pixel
            place += 1
        left = left / 2
        pixel -= stride


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
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        i = padded(lens, n, y, x)
        facing = cos_incidence(p, jumps, lens, i, y, x)
        put(cosine, row + x, facing)
        put(sigma, row + x, model_sigma(noise, lens, at(p, i), facing))
        x += stride


@wp.func
def source_of(
    moved: wp.array(dtype=wp.uint16), lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.vec2i:
    """Return row and column of the pixel whose surface this one sees, and clear its entry."""
    out = wp.vec2i(y, x)
    pixel = (n * lens.height + y) * lens.width + x
    code = wp.int32(at_word(moved, pixel))
    if code != 0:
        put_word(moved, pixel, _STILL)
        offset = (code & 255) - 128
        down = (code >> 8) & 1
        out = wp.vec2i(y + offset * down, x + offset * (1 - down))
    return out


@wp.func
def blocks_of(pixels: wp.int32) -> wp.int32:
    """Return how many counters the pixels of a frame need."""
    return (pixels + 3) / 4

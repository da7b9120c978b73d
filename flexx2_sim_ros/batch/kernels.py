"""
The base model as Warp kernels: one source for CPU and CUDA, from clean depth to noisy frames.

`formulas.surfaces` explains the model; edges move in `edge_kernels`.
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
from flexx2_sim_ros.batch.compiled import AXIAL, compiled, counter_of, four_normals, one_of
from flexx2_sim_ros.batch.frame import (
    blocks_of,
    BORDER,
    Frame,
    Lens,
    Noise,
    of_listed,
    of_pixels,
    OPTIONS,
    Own,
    own_of,
    padded,
    place,
    SPREAD,
    Surfaces,
)
from flexx2_sim_ros.formulas import pixels, surfaces
from flexx2_sim_ros.physics import surface
import warp as wp

wp.set_module_options(OPTIONS)

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
_is_seen = compiled(pixels.is_seen)


@wp.kernel
def invert(f: Frame, depth: wp.array(dtype=wp.float32), first: wp.int32):
    """Write inverse depth, 0 where depth is not a distance; no pixel is listed."""
    n, y, c = wp.tid()
    if y == 0 and c == 0:
        f.listed[n * SPREAD] = 0
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, f.lens.width)
    stride = stride_of(f.lens.width)
    source = place(f.lens, first + n, y, 0)
    target = padded(f.lens, n, y, 0)
    while x < end:
        put(f.surfaces.p, target + x, _inverse_depth(at(depth, source + x), _NEAREST, _FARTHEST))
        x += stride


@wp.func
def jumps_to(s: Surfaces, i: wp.int32, step: wp.int32, here: wp.float32) -> wp.bool:
    """Say whether depth jumps to the next pixel of a line whose pixels are ``step`` apart."""
    before, after, beyond = at(s.p, i - step), at(s.p, i + step), at(s.p, i + 2 * step)
    return _is_jump(before, here, after, beyond, s.lens.jump_share, s.lens.steep_share)


@wp.func
def jumps_at(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.uint8:
    """Return the depth jumps to the right of (1) and below (2) a pixel."""
    i = padded(s.lens, n, y, x)
    here = at(s.p, i)
    across = jumps_to(s, i, 1, here)
    down = jumps_to(s, i, s.lens.width + BORDER, here)
    below = wp.where(y < s.lens.height - 1, _COLUMN, _NONE)
    return wp.where(across and x < s.lens.width - 1, _ROW, _NONE) | wp.where(down, below, _NONE)


@of_pixels()
def find_jumps(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Flag the depth jumps of every pixel."""
    put_byte(f.surfaces.jumps, padded(f.lens, n, y, x), jumps_at(f.surfaces, n, y, x))


@wp.kernel
def list_jumps(f: Frame):
    """Flag the depth jumps of every pixel, and list the pixels that have one. For CUDA."""
    n, y, c = wp.tid()
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, f.lens.width)
    stride = stride_of(f.lens.width)
    row = padded(f.lens, n, y, 0)
    found = wp.int32(0)
    bits = wp.int32(0)
    while x < end:
        jump = jumps_at(f.surfaces, n, y, x)
        put_byte(f.surfaces.jumps, row + x, jump)
        bits = bits * 2
        if jump != _NONE:
            bits += 1
            found += 1
        x += stride
    last = y * f.lens.width + x - stride
    add_to_list(f, n, last, stride, bits, found)


@wp.func
def add_to_list(
    f: Frame, n: wp.int32, last: wp.int32, stride: wp.int32, bits: wp.int32, found: wp.int32
):
    """List pixels of an environment of the pass: of every ``stride``, back from the last."""
    entry = n * f.lens.height * f.lens.width + add_each(f.listed, n * SPREAD, found)
    pixel = wp.int32(last)
    left = wp.int32(bits)
    while left > 0:
        if left % 2 == 1:
            f.pixel_list[entry] = pixel
            entry += 1
        left = left / 2
        pixel -= stride


@wp.func
def slope_along(
    s: Surfaces, i: wp.int32, step: wp.int32, here: wp.float32, own: wp.uint8, jump: wp.uint8
) -> wp.float32:
    """Return the slope of inverse depth along a line whose pixels are ``step`` apart."""
    before, after = at(s.p, i - step), at(s.p, i + step)
    return _slope_between(
        at(s.p, i - 2 * step),
        before,
        here,
        after,
        at(s.p, i + 2 * step),
        # Where a line ends there is nothing to take a slope to.
        before <= 0.0 or (at_byte(s.jumps, i - step) & jump) != _NONE,
        after <= 0.0 or (own & jump) != _NONE,
    )


@wp.func
def slopes(s: Surfaces, i: wp.int32) -> wp.vec2f:
    """Return the slopes of inverse depth along the row and the column, 1/m a pixel."""
    here, own = at(s.p, i), at_byte(s.jumps, i)
    du = slope_along(s, i, 1, here, own, _ROW)
    dv = slope_along(s, i, s.lens.width + BORDER, here, own, _COLUMN)
    return wp.vec2f(du, dv)


@wp.func
def cos_incidence(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.float32:
    """Return the cosine between a pixel's ray and its surface's normal; 1 without a return."""
    i = padded(s.lens, n, y, x)
    d = slopes(s, i)
    u = wp.float32(x) - s.lens.cx
    v = wp.float32(y) - s.lens.cy
    fx, fy = s.lens.fx, s.lens.fy
    return _cos_incidence(at(s.p, i), d[0], d[1], u, v, u / fx, v / fy, fx, fy)


@wp.func
def model_sigma(noise: Noise, lens: Lens, inverse: wp.float32, cosine: wp.float32) -> wp.float32:
    """Return sigma_z, metres; 0 without a return."""
    return _sigma_of_surface(
        inverse, cosine, noise.a, noise.b, noise.c, noise.d, noise.n, lens.cap
    )


@of_pixels()
def describe(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the cosine of the incidence angle and sigma_z of every pixel, for effects."""
    i = place(f.lens, n, y, x)
    facing = cos_incidence(f.surfaces, n, y, x)
    put(f.facing, i, facing)
    put(
        f.expected,
        i,
        model_sigma(own.noise, f.lens, at(f.surfaces.p, padded(f.lens, n, y, x)), facing),
    )


@wp.func
def source_of(
    moved: wp.array(dtype=wp.uint16), lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.vec2i:
    """Return row and column of the pixel whose surface this one sees, and clear its entry."""
    out = wp.vec2i(y, x)
    pixel = place(lens, n, y, x)
    code = wp.int32(at_word(moved, pixel))
    if code != 0:
        put_word(moved, pixel, _STILL)
        offset = (code & 255) - 128
        down = (code >> 8) & 1
        out = wp.vec2i(y + offset * down, x + offset * (1 - down))
    return out


@wp.func
def noisy(
    s: Surfaces, noise: Noise, n: wp.int32, y: wp.int32, x: wp.int32, normal: wp.float32
) -> wp.float32:
    """Return what is seen of the surface at a pixel, with axial noise."""
    inverse = at(s.p, padded(s.lens, n, y, x))
    sigma = model_sigma(noise, s.lens, inverse, cos_incidence(s, n, y, x))
    z = distance(inverse, 0.0)
    value = z + sigma * normal
    seen = _is_seen(z, value, noise.range_min, noise.range_max)
    return wp.where(seen, value, s.lens.invalid)


@wp.kernel
def draw_normals(f: Frame, chunk: wp.int32):
    """Write normals, ``chunk`` blocks of four a thread; there is room for whole blocks."""
    n, c = wp.tid()
    key = f.keys[f.first + n]
    stamp = f.stamps[f.first + n]
    blocks = blocks_of(f.lens.height * f.lens.width)
    base = n * 4 * blocks
    block = c * chunk
    end = wp.min(block + chunk, blocks)
    while block < end:
        four = four_normals(counter_of(block, AXIAL, stamp), key)
        i = base + 4 * block
        put(f.normals, i, four[0])
        put(f.normals, i + 1, four[1])
        put(f.normals, i + 2, four[2])
        put(f.normals, i + 3, four[3])
        block += 1


@of_pixels()
def observe_rows(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write a row of the frame, as if no edge had moved. For the CPU."""
    pixel = y * f.lens.width + x
    normal = at(f.normals, n * blocks_of(f.lens.height * f.lens.width) * 4 + pixel)
    put(f.out, place(f.lens, own.env, y, x), noisy(f.surfaces, own.noise, n, y, x, normal))


@wp.kernel(launch_bounds=(256, 8))  # docs/batch.md#on-a-gpu
def observe_blocks(f: Frame):
    """Write four pixels that share a counter. For CUDA."""
    n, block = wp.tid()
    own = own_of(f, n)
    four = four_normals(counter_of(block, AXIAL, own.stamp), own.key)
    y = 4 * block / f.lens.width
    x = 4 * block - y * f.lens.width
    for k in range(4):
        if y < f.lens.height:
            source = source_of(f.moved, f.lens, n, y, x)
            value = noisy(f.surfaces, own.noise, n, source[0], source[1], four[k])
            put(f.out, place(f.lens, own.env, y, x), value)
        x += 1
        if x == f.lens.width:
            x = 0
            y += 1


@of_listed()
def observe_moved(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write again the few pixels that see another surface. For the CPU."""
    pixel = y * f.lens.width + x
    source = source_of(f.moved, f.lens, n, y, x)
    four = four_normals(counter_of(pixel / 4, AXIAL, own.stamp), own.key)
    value = noisy(f.surfaces, own.noise, n, source[0], source[1], one_of(four, pixel % 4))
    put(f.out, place(f.lens, own.env, y, x), value)


@wp.kernel
def blank_outside(
    outside: wp.array(dtype=wp.bool), invalid: wp.float32, out: wp.array(dtype=wp.float32)
):
    """Write ``invalid`` where ``outside``, (H * W,), is true, in every environment."""
    n, i = wp.tid()
    if outside[i]:
        out[n * outside.shape[0] + i] = invalid

"""The base model's noise as Warp kernels: from surfaces and moved edges to frames."""

from flexx2_sim_ros.batch.arithmetic import AXIAL, counter_of, four_normals, one_of
from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.frame import (
    blocks_of,
    Frame,
    Noise,
    of_listed,
    of_pixels,
    OPTIONS,
    Own,
    own_of,
    padded,
    place,
    Surfaces,
)
from flexx2_sim_ros.batch.kernels import cos_incidence, distance, model_sigma, source_of
from flexx2_sim_ros.formulas import pixels
import warp as wp

wp.set_module_options(OPTIONS)

_is_seen = compiled(pixels.is_seen)


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

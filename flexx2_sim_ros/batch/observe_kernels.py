"""The base model's noise as Warp kernels: from surfaces and moved edges to frames."""

from flexx2_sim_ros.batch.arithmetic import AXIAL, counter_of, four_normals, one_of
from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.kernels import (
    blocks_of,
    cos_incidence,
    distance,
    Lens,
    model_sigma,
    Noise,
    OPTIONS,
    padded,
    source_of,
    SPREAD,
)
from flexx2_sim_ros.formulas import pixels
import warp as wp

wp.set_module_options(OPTIONS)

_is_seen = compiled(pixels.is_seen)


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


@wp.kernel(launch_bounds=(256, 8))  # docs/batch.md#on-a-gpu
def observe_blocks(
    p: wp.array(dtype=wp.float32),
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    noises: wp.array(dtype=Noise),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    moved: wp.array(dtype=wp.uint16),
    out: wp.array(dtype=wp.float32),
):
    """Write four pixels that share a counter. For CUDA."""
    n, block = wp.tid()
    noise = noises[first + n]
    pixels = lens.height * lens.width
    four = four_normals(counter_of(block, AXIAL, stamps[first + n]), keys[first + n])
    y = 4 * block / lens.width
    x = 4 * block - y * lens.width
    for k in range(4):
        if y < lens.height:
            source = source_of(moved, lens, n, y, x)
            put(
                out,
                (first + n) * pixels + 4 * block + k,
                noisy(p, jumps, noise, lens, n, source[0], source[1], four[k]),
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
    noises: wp.array(dtype=Noise),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    moved: wp.array(dtype=wp.uint16),
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float32),
):
    """Write again the few pixels that see another surface. For the CPU."""
    n = wp.tid()
    noise = noises[first + n]
    pixels = lens.height * lens.width
    entry = wp.int32(0)
    while entry < listed[n * SPREAD]:
        pixel = pixel_list[n * pixels + entry]
        y = pixel / lens.width
        source = source_of(moved, lens, n, y, pixel - y * lens.width)
        four = four_normals(counter_of(pixel / 4, AXIAL, stamps[first + n]), keys[first + n])
        put(
            out,
            (first + n) * pixels + pixel,
            noisy(p, jumps, noise, lens, n, source[0], source[1], one_of(four, pixel % 4)),
        )
        entry += 1

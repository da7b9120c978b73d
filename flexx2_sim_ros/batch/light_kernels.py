"""The light of each pixel, as Warp kernels."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.effect_formulas import (
    agreed,
    mix_neighbours,
    near_jump,
    reflectivity_at,
    returned_light,
    Surfaces,
)
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import add_to_list, Lens, OPTIONS, padded, SPREAD
import warp as wp

wp.set_module_options(OPTIONS)


@wp.struct
class Phasors:
    """The light of the pixels of a pass, flat images."""

    amplitude: wp.array(dtype=wp.float32)
    shifts: wp.array(dtype=wp.float32)  # of each frequency, one image after the other
    total: wp.array(dtype=wp.float32)  # sum over the frequencies so far, of what becomes amplitude
    pitch: wp.int32  # from one frequency's shifts to the next one's


@wp.func
def mix(
    surfaces: Surfaces,
    lens: Lens,
    light: Light,
    side: wp.float32,
    key: wp.vec2ui,
    n: wp.int32,
    y: wp.int32,
    x: wp.int32,
    phasors: Phasors,
):
    """Write the light of the footprint of a pixel."""
    pixel = (n * lens.height + y) * lens.width + x
    mixed = mix_neighbours(surfaces, lens, light, side, key, n, y, x)
    put(phasors.amplitude, pixel, mixed[3])
    z = 1.0 / at(surfaces.p, padded(lens, n, y, x))
    shifts = agreed(light, wp.vec3f(mixed[0], mixed[1], mixed[2]), z)
    for k in range(3):
        if k < light.frequencies:
            put(phasors.shifts, k * phasors.pitch + pixel, shifts[k])


@wp.kernel
def find_light(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    facing: wp.array(dtype=wp.float32),
    phasors: Phasors,
    lists: wp.bool,
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Write the light of every pixel, and list those next to depth jumps for `mix_listed`."""
    n, y, c = wp.tid()
    e = effects[first + n]
    light = lights[first + n]
    i = padded(lens, n, y, 0)
    row = (n * lens.height + y) * lens.width
    start = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    x = wp.int32(start)
    while x < end:
        rho = reflectivity_at(surfaces, lens, n, y, x)
        amplitude = returned_light(rho, at(facing, row + x), at(surfaces.p, i + x))
        put(phasors.amplitude, row + x, amplitude)
        x += stride
    f = wp.int32(0)
    while f < light.frequencies:
        x = wp.int32(start)
        while x < end:
            put(phasors.shifts, f * phasors.pitch + row + x, 0.0)
            x += stride
        f += 1
    if lists and e.flying_pixels_side > 0.0:
        found = wp.int32(0)
        bits = wp.int32(0)
        x = wp.int32(start)
        while x < end:
            bits = bits * 2
            if at(surfaces.p, i + x) > 0.0 and near_jump(surfaces, lens, n, y, x):
                bits += 1
                found += 1
            x += stride
        add_to_list(lens, n, y * lens.width + x - stride, stride, bits, found, listed, pixel_list)


@wp.kernel
def mix_rows(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    keys: wp.array(dtype=wp.vec2ui),
    phasors: Phasors,
):
    """Write the light of the footprints next to the depth jumps of a row. For the CPU."""
    n, y = wp.tid()
    light = lights[first + n]
    side = effects[first + n].flying_pixels_side
    i = padded(lens, n, y, 0)
    x = wp.int32(0)
    while x < lens.width and side > 0.0:
        if at(surfaces.p, i + x) > 0.0 and near_jump(surfaces, lens, n, y, x):
            mix(surfaces, lens, light, side, keys[first + n], n, y, x, phasors)
        x += 1


@wp.kernel
def mix_listed(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    threads: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    keys: wp.array(dtype=wp.vec2ui),
    phasors: Phasors,
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Write the light of the footprints of the listed pixels. For CUDA: none waits for others."""
    n, thread = wp.tid()
    side = effects[first + n].flying_pixels_side
    light = lights[first + n]
    entry = wp.int32(thread)
    while entry < listed[n * SPREAD]:
        pixel = pixel_list[n * lens.height * lens.width + entry]
        y = pixel / lens.width
        mix(surfaces, lens, light, side, keys[first + n], n, y, pixel - y * lens.width, phasors)
        entry += threads

"""The light of each pixel, as Warp kernels."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.effect_formulas import (
    agreed,
    mix_neighbours,
    near_jump,
    reflectivity_at,
    returned_light,
)
from flexx2_sim_ros.batch.frame import (
    Frame,
    of_frequencies,
    of_listed,
    of_pixels,
    OPTIONS,
    Own,
    padded,
    place,
    Surfaces,
)
from flexx2_sim_ros.batch.kernels import add_to_list
import warp as wp

wp.set_module_options(OPTIONS)


@of_pixels()
def find_light(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of every pixel."""
    i = place(f.lens, n, y, x)
    rho = reflectivity_at(f.surfaces, n, y, x)
    inverse = at(f.surfaces.p, padded(f.lens, n, y, x))
    put(f.amplitude, i, returned_light(rho, at(f.facing, i), inverse))


@of_frequencies()
def clear_shifts(f: Frame, own: Own, k: wp.int32, n: wp.int32, y: wp.int32, x: wp.int32):
    """Begin without a shift."""
    put(f.shifts, k * f.pitch + place(f.lens, n, y, x), 0.0)


@wp.func
def is_mixed(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.bool:
    """Say whether a pixel has a return and is next to a depth jump."""
    return at(s.p, padded(s.lens, n, y, x)) > 0.0 and near_jump(s, n, y, x)


@wp.func
def mix(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of the footprint of a pixel."""
    pixel = place(f.lens, n, y, x)
    side = own.effects.flying_pixels_side
    mixed = mix_neighbours(f.surfaces, own.light, side, own.key, n, y, x)
    put(f.amplitude, pixel, mixed[3])
    z = 1.0 / at(f.surfaces.p, padded(f.lens, n, y, x))
    shifts = agreed(own.light, wp.vec3f(mixed[0], mixed[1], mixed[2]), z)
    for k in range(3):
        if k < own.light.frequencies:
            put(f.shifts, k * f.pitch + pixel, shifts[k])


@wp.func
def mixes(f: Frame, own: Own) -> wp.bool:
    """Say whether an environment has the effect flying_pixels."""
    return own.effects.flying_pixels_side > 0.0


@of_pixels(when=mixes)
def mix_rows(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of the footprints next to the depth jumps of a row. For the CPU."""
    if is_mixed(f.surfaces, n, y, x):
        mix(f, own, n, y, x)


@wp.kernel
def list_mixed(f: Frame):
    """List the pixels next to depth jumps for `mix_listed`. For CUDA."""
    n, y, c = wp.tid()
    if f.effects[f.first + n].flying_pixels_side <= 0.0:
        return
    found = wp.int32(0)
    bits = wp.int32(0)
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, f.lens.width)
    stride = stride_of(f.lens.width)
    while x < end:
        bits = bits * 2
        if is_mixed(f.surfaces, n, y, x):
            bits += 1
            found += 1
        x += stride
    last = y * f.lens.width + x - stride
    add_to_list(f.lens, f.listed, f.pixel_list, n, last, stride, bits, found)


@of_listed(when=mixes)
def mix_listed(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of the footprints of the listed pixels. For CUDA: none waits for others."""
    mix(f, own, n, y, x)

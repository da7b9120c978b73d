"""The light of each pixel, as Warp kernels."""

from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.effect_formulas import (
    agreed,
    mix_neighbours,
    near_jump,
    reflectivity_at,
    returned_light,
    Surfaces,
)
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import Lens, OPTIONS, padded
import warp as wp

wp.set_module_options(OPTIONS)


@wp.struct
class Phasors:
    """The light of the pixels of a pass, flat images."""

    amplitude: wp.array(dtype=wp.float32)
    shifts: wp.array(dtype=wp.float32)  # of each frequency, one image after the other
    total: wp.array(dtype=wp.float32)  # sum over the frequencies so far, of what becomes amplitude
    pitch: wp.int32  # from one frequency's shifts to the next one's


@wp.kernel
def find_light(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    keys: wp.array(dtype=wp.vec2ui),
    facing: wp.array(dtype=wp.float32),
    phasors: Phasors,
):
    """Write the light of every pixel and, next to depth jumps, of its footprint."""
    n, y, c = wp.tid()
    e = effects[first + n]
    light = lights[first + n]
    i = padded(lens, n, y, 0)
    row = (n * lens.height + y) * lens.width
    start = c * chunk
    end = wp.min(start + chunk, lens.width)
    x = wp.int32(start)
    while x < end:
        rho = reflectivity_at(surfaces, lens, n, y, x)
        amplitude = returned_light(rho, at(facing, row + x), at(surfaces.p, i + x))
        put(phasors.amplitude, row + x, amplitude)
        x += 1
    f = wp.int32(0)
    while f < light.frequencies:
        x = wp.int32(start)
        while x < end:
            put(phasors.shifts, f * phasors.pitch + row + x, 0.0)
            x += 1
        f += 1
    side = e.flying_pixels_side
    key = keys[first + n]
    if side > 0.0:
        x = wp.int32(start)
        while x < end:
            if at(surfaces.p, i + x) > 0.0 and near_jump(surfaces, lens, n, y, x):
                mixed = mix_neighbours(surfaces, lens, light, side, key, n, y, x)
                put(phasors.amplitude, row + x, mixed[3])
                shifts = agreed(
                    light, wp.vec3f(mixed[0], mixed[1], mixed[2]), 1.0 / at(surfaces.p, i + x)
                )
                for k in range(3):
                    if k < light.frequencies:
                        put(phasors.shifts, k * phasors.pitch + row + x, shifts[k])
            x += 1

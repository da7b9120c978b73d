"""What the formulas of effects need to know of a pixel and its neighbours, in Warp's kernels."""

import math

from flexx2_sim_ros.batch.arrays import at, at_byte
from flexx2_sim_ros.batch.compiled import (
    compiled,
    counter_of,
    four_normals,
    one_of,
    philox4x32,
    uniform,
)
from flexx2_sim_ros.batch.effect_tables import Light
from flexx2_sim_ros.batch.frame import BORDER, Own, padded, place, Surfaces
from flexx2_sim_ros.batch.kernels import cos_incidence
from flexx2_sim_ros.effects import flying_pixels, range_wrap, unwrapping
from flexx2_sim_ros.formulas import fastmath
from flexx2_sim_ros.formulas import surfaces as surface_formulas
import warp as wp

_WRAP = wp.constant(wp.uint32(range_wrap.RangeWrap.stream))
_WRAP_SHARE = wp.constant(wp.uint32(range_wrap.RangeWrap.share_stream))
_ROW_PLACES = wp.constant(wp.uint32(flying_pixels.FlyingPixels.stream))
_COLUMN_PLACES = wp.constant(wp.uint32(flying_pixels.FlyingPixels.column_stream))
_LEAST = wp.constant(wp.float32(flying_pixels.LEAST_WEIGHT))
TURN = wp.constant(wp.float32(2.0 * math.pi))

returned_light = compiled(surface_formulas.returned_light)
_usable_reflectivity = compiled(surface_formulas.usable_reflectivity)
_direction = compiled(fastmath.direction)
_shift_between = compiled(fastmath.shift_between)
_border_place = compiled(flying_pixels.border_place)
_beyond_border = compiled(flying_pixels.beyond_border)
_widest_apart = compiled(range_wrap.widest_apart)
_is_apart = compiled(range_wrap.is_apart)
_misread = compiled(range_wrap.misread)
_wrong_jump = compiled(range_wrap.wrong_jump)
_is_beyond = compiled(range_wrap.is_beyond)
_folded = compiled(range_wrap.folded)
_agreed_shift = compiled(unwrapping.agreed_shift)
_rewrapped = compiled(unwrapping.rewrapped)


@wp.func
def draw_four(block: wp.int32, stream: wp.uint32, stamp: wp.int64, key: wp.vec2ui) -> wp.vec4f:
    """Return the random numbers of a stream, in (0, 1], of the four pixels from 4 * block on."""
    u = philox4x32(counter_of(block, stream, stamp), key)
    return wp.vec4f(uniform(u[0]), uniform(u[1]), uniform(u[2]), uniform(u[3]))


@wp.func
def draw(pixel: wp.int32, stream: wp.uint32, stamp: wp.int64, key: wp.vec2ui) -> wp.float32:
    """Return a pixel's random number of a stream, in (0, 1]."""
    return one_of(draw_four(pixel / 4, stream, stamp, key), pixel % 4)


@wp.func
def draw_normal(
    number: wp.int32, stream: wp.uint32, stamp: wp.int64, key: wp.vec2ui
) -> wp.float32:
    """Return a standard normal of a stream."""
    four = four_normals(counter_of(number / 4, stream, stamp), key)
    return one_of(four, number % 4)


@wp.func
def reflectivity_at(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.float32:
    """Return a pixel's reflectivity, 0..1; 1 where none is given."""
    rho = wp.float32(1.0)
    if s.reflectivity.shape[0] > 0:
        given = at(s.reflectivity, place(s.lens, s.first_of_reflectivity + n, y, x))
        rho = _usable_reflectivity(given)
    return rho


@wp.func
def amplitude_at(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.float32:
    """Return the light that comes back from a pixel's surface, 1/m^2."""
    rho = reflectivity_at(s, n, y, x)
    return returned_light(rho, cos_incidence(s, n, y, x), at(s.p, padded(s.lens, n, y, x)))


@wp.func
def near_jump(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.bool:
    """Say whether a depth jump lies within the 3 x 3 pixels around."""
    near = wp.bool(False)
    i = padded(s.lens, n, y, x)
    pitch = s.lens.width + BORDER
    for k in range(3):
        for j in range(2):
            across = at_byte(s.jumps, i + (k - 1) * pitch + j - 1)
            down = at_byte(s.jumps, i + (j - 1) * pitch + k - 1)
            if (wp.int32(across) & 1) != 0 or (wp.int32(down) & 2) != 0:
                near = True
    return near


@wp.func
def border(
    s: Surfaces,
    bit: wp.int32,
    stream: wp.uint32,
    key: wp.vec2ui,
    n: wp.int32,
    y: wp.int32,
    x: wp.int32,
) -> wp.float32:
    """Return where the border to the pixel on the right (bit 1) or below (bit 2) is, 0..1."""
    jumps = (wp.int32(at_byte(s.jumps, padded(s.lens, n, y, x))) & bit) != 0
    return _border_place(draw(y * s.lens.width + x, stream, wp.int64(0), key), jumps)


@wp.func
def parts(
    s: Surfaces, side: wp.float32, key: wp.vec2ui, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.mat33f:
    """Return how much of a square footprint lies on each of the 3 x 3 pixels."""
    across = wp.vec3f()
    down = wp.vec3f()
    if x > 0:
        across[0] = _beyond_border(side, 1.0 - border(s, 1, _ROW_PLACES, key, n, y, x - 1))
    if x + 1 < s.lens.width:
        across[2] = _beyond_border(side, border(s, 1, _ROW_PLACES, key, n, y, x))
    if y > 0:
        down[0] = _beyond_border(side, 1.0 - border(s, 2, _COLUMN_PLACES, key, n, y - 1, x))
    if y + 1 < s.lens.height:
        down[2] = _beyond_border(side, border(s, 2, _COLUMN_PLACES, key, n, y, x))
    across[1] = 1.0 - across[0] - across[2]
    down[1] = 1.0 - down[0] - down[2]
    return wp.outer(down, across)


@wp.func
def light_around(
    s: Surfaces, turns: wp.float32, weights: wp.mat33f, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.vec2f:
    """Return the mean phasor of the 3 x 3 pixels that have a return, by weight."""
    around = wp.vec3f()
    for k in range(9):
        yy = y + k // 3 - 1
        xx = x + k % 3 - 1
        weight = weights[k // 3, k % 3]
        if weight > 0.0:  # So it is within the image.
            inverse = at(s.p, padded(s.lens, n, yy, xx))
            if inverse > 0.0:
                cosine, sine = _direction(turns / inverse)
                amplitude = amplitude_at(s, n, yy, xx)
                around += weight * wp.vec3f(amplitude * cosine, amplitude * sine, 1.0)
    return wp.vec2f(around[0], around[1]) / wp.max(around[2], _LEAST)


@wp.func
def mix_neighbours(
    s: Surfaces,
    light: Light,
    side: wp.float32,
    key: wp.vec2ui,
    n: wp.int32,
    y: wp.int32,
    x: wp.int32,
) -> wp.vec4f:
    """Return the shift of each frequency, and the amplitude, of a footprint across an edge."""
    out = wp.vec4f()
    z = 1.0 / at(s.p, padded(s.lens, n, y, x))
    weights = parts(s, side, key, n, y, x)
    for k in range(3):
        if k < light.frequencies:
            turns = light.turns[k]
            mixed = light_around(s, turns, weights, n, y, x)
            cosine, sine = _direction(turns * z)
            out[k] = _shift_between(mixed[0], mixed[1], cosine, sine, TURN * turns)
            out[3] += light.weights[k] * wp.length(mixed)
    return out


@wp.func
def any_apart(light: Light, errors: wp.vec3f, sigma: wp.float32) -> wp.bool:
    """Say whether two frequencies' distances, and their noise, are apart by half a step."""
    found = wp.bool(False)
    for k in range(3):
        i = k // 2
        j = wp.min(k + 1, 2)
        if j < light.frequencies:
            more = _widest_apart(light.spreads[i], light.spreads[j], sigma)
            if _is_apart(errors[i], errors[j], more, light.steps[k]):
                found = True
    return found


@wp.func
def agreed(light: Light, shifts: wp.vec3f, depth: wp.float32) -> wp.vec3f:
    """Return the shifts on whose distance a camera agrees that unwraps its frequencies."""
    out = shifts
    if light.frequencies > 1 and any_apart(light, shifts, 0.0):
        there = _agreed_shift(
            shifts, light.spans, light.weights, light.frequencies, light.ambiguity, depth
        )
        for f in range(3):
            if f < light.frequencies:
                out[f] = _rewrapped(shifts[f], there, light.spans[f])
    return out


@wp.func
def unwrapped(
    own: Own,
    shifts: wp.vec3f,
    sigma: wp.float32,
    pixel: wp.int32,
    pixels: wp.int32,
    here: wp.float32,
) -> wp.float32:
    """Return the measured depth after unwrapping, which noise can make wrong."""
    light = own.light
    spread = own.effects.range_wrap_noise * sigma
    out = here
    if light.frequencies > 1 and any_apart(light, shifts, spread):
        errors = wp.vec3f()
        for f in range(3):
            if f < light.frequencies:
                normal = draw_normal(f * pixels + pixel, _WRAP, own.stamp, own.key)
                errors[f] = _misread(shifts[f], light.spreads[f], spread, normal)
        if any_apart(light, errors, 0.0):
            out = here + _wrong_jump(
                errors, light.spans, light.weights, light.frequencies, light.ambiguity, here
            )
    return out


@wp.func
def wrapped(own: Own, z: wp.float32, pixel: wp.int32, here: wp.float32) -> wp.float32:
    """Return a measured depth modulo the ambiguity; NaN where the camera notices."""
    out = here
    if _is_beyond(here, z, own.light.ambiguity, own.noise.range_max):
        chance = draw(pixel, _WRAP_SHARE, own.stamp, own.key)
        out = _folded(here, own.light.ambiguity, chance, own.effects.range_wrap_share)
    return out

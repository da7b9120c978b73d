"""The formulas of `effects` once more, as functions of Warp's kernels."""

import math

from flexx2_sim_ros.batch.arithmetic import (
    arctan2,
    cos_sin_turns,
    counter_of,
    exp,
    four_normals,
    log,
    one_of,
    philox4x32,
    uniform,
)
from flexx2_sim_ros.batch.arrays import at, at_byte
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import cos_incidence, Lens, padded
from flexx2_sim_ros.effects.ambient_light import DARKEST
from flexx2_sim_ros.effects.range_wrap import RangeWrap, RARE
from flexx2_sim_ros.formulas import surfaces as surface_formulas
import warp as wp

_WRAP = wp.constant(wp.uint32(RangeWrap.stream))
_FLT_MAX = wp.constant(wp.float32(3.4028235e38))
_TURN = wp.constant(wp.float32(2.0 * math.pi))
_DARKEST = wp.constant(wp.float32(DARKEST))
_RARE = wp.constant(wp.float32(RARE))

returned_light = compiled(surface_formulas.returned_light)
_usable_reflectivity = compiled(surface_formulas.usable_reflectivity)


@wp.struct
class Surfaces:
    """What the base model's first kernels made of the pass's depth images, and reflectivity."""

    p: wp.array(dtype=wp.float32)
    jumps: wp.array(dtype=wp.uint8)
    reflectivity: wp.array(dtype=wp.float32)  # of the same pixels; empty: 1 everywhere
    first_of_reflectivity: wp.int32


@wp.func
def draw(pixel: wp.int32, stream: wp.uint32, stamp: wp.int64, key: wp.vec2ui) -> wp.float32:
    """Return a pixel's random number of a stream, in (0, 1]."""
    u = philox4x32(counter_of(pixel / 4, stream, stamp), key)
    four = wp.vec4f(uniform(u[0]), uniform(u[1]), uniform(u[2]), uniform(u[3]))
    return one_of(four, pixel % 4)


@wp.func
def draw_normal(
    number: wp.int32, stream: wp.uint32, stamp: wp.int64, key: wp.vec2ui
) -> wp.float32:
    """Return a standard normal of a stream."""
    four = four_normals(counter_of(number / 4, stream, stamp), key)
    return one_of(four, number % 4)


@wp.func
def phase_of(turns: wp.float32) -> wp.vec2f:
    """Return cosine and sine of any number of turns."""
    cosine, sine = cos_sin_turns(turns - wp.floor(turns))
    return wp.vec2f(cosine, sine)


@wp.func
def reflectivity_at(
    surfaces: Surfaces, lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.float32:
    """Return a pixel's reflectivity, 0..1; 1 where none is given."""
    rho = wp.float32(1.0)
    if surfaces.reflectivity.shape[0] > 0:
        given = at(
            surfaces.reflectivity,
            ((surfaces.first_of_reflectivity + n) * lens.height + y) * lens.width + x,
        )
        rho = _usable_reflectivity(given)
    return rho


@wp.func
def amplitude_at(
    surfaces: Surfaces, lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.float32:
    """Return the light that comes back from a pixel's surface, 1/m^2."""
    i = padded(lens, n, y, x)
    inverse = at(surfaces.p, i)
    return returned_light(
        reflectivity_at(surfaces, lens, n, y, x),
        cos_incidence(surfaces.p, surfaces.jumps, lens, i, y, x),
        inverse,
    )


@wp.func
def near_jump(surfaces: Surfaces, lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.bool:
    """Say whether a depth jump lies within the 3 x 3 pixels around."""
    near = wp.bool(False)
    i = padded(lens, n, y, x)
    pitch = lens.width + 4
    for k in range(3):
        for j in range(2):
            across = at_byte(surfaces.jumps, i + (k - 1) * pitch + j - 1)
            down = at_byte(surfaces.jumps, i + (j - 1) * pitch + k - 1)
            if (wp.int32(across) & 1) != 0 or (wp.int32(down) & 2) != 0:
                near = True
    return near


@wp.func
def mix_neighbours(
    surfaces: Surfaces,
    lens: Lens,
    light: Light,
    share: wp.float32,
    n: wp.int32,
    y: wp.int32,
    x: wp.int32,
) -> wp.vec4f:
    """Return the shift of each frequency, and the amplitude, of a footprint across an edge."""
    out = wp.vec4f()
    z = 1.0 / at(surfaces.p, padded(lens, n, y, x))
    own_amplitude = amplitude_at(surfaces, lens, n, y, x)
    for f in range(3):
        if f < light.frequencies:
            turns = light.turns[f]
            total = wp.vec2f()
            count = wp.float32(0.0)
            for k in range(9):
                yy = y + k // 3 - 1
                xx = x + k % 3 - 1
                if yy >= 0 and yy < lens.height and xx >= 0 and xx < lens.width:
                    inverse = at(surfaces.p, padded(lens, n, yy, xx))
                    if inverse > 0.0:
                        count += 1.0
                        total += amplitude_at(surfaces, lens, n, yy, xx) * phase_of(
                            turns / inverse
                        )
            direction = phase_of(turns * z)
            own = own_amplitude * direction
            mixed = own + share * (total / count - own)
            real = mixed[0] * direction[0] + mixed[1] * direction[1]
            imaginary = mixed[1] * direction[0] - mixed[0] * direction[1]
            out[f] = arctan2(imaginary, real) / (_TURN * turns)
            out[3] += light.weights[f] * wp.length(mixed)
    return out


@wp.func
def wiggle(e: Effects, turns: wp.float32) -> wp.float32:
    """Return the harmonics of the modulation at a phase."""
    one = phase_of(turns)
    two = phase_of(2.0 * turns)
    three = phase_of(3.0 * turns)
    four = phase_of(4.0 * turns)
    return e.wiggling_strength * (
        e.wiggling_a1 * one[1]
        + e.wiggling_b1 * one[0]
        + e.wiggling_a2 * two[1]
        + e.wiggling_b2 * two[0]
        + e.wiggling_a3 * three[1]
        + e.wiggling_b3 * three[0]
        + e.wiggling_a4 * four[1]
        + e.wiggling_b4 * four[0]
    )


@wp.func
def common_shift(
    e: Effects, grain: wp.float32, amplitude: wp.float32, seconds: wp.float32
) -> wp.float32:
    """Return the shift that all frequencies have alike."""
    shift = e.fixed_pattern_strength * e.fixed_pattern_rms * grain
    if e.amplitude_bias_strength > 0.0:
        below = log(wp.max(amplitude, 1.0e-37)) - log(e.amplitude_bias_knee)
        hinge = wp.min(wp.max(below, -e.amplitude_bias_span), 0.0)
        shift += e.amplitude_bias_strength * (
            e.amplitude_bias_intercept + e.amplitude_bias_slope * hinge
        )
    shift += e.offset_strength * e.offset_bias
    if e.warm_up_drift_strength > 0.0:
        age = e.warm_up_drift_uptime + seconds
        shift += e.warm_up_drift_strength * e.warm_up_drift_bias * exp(-age / e.warm_up_drift_tau)
    return shift


@wp.func
def noise_at(e: Effects, sigma: wp.float32, amplitude: wp.float32) -> wp.float32:
    """Return the sigma of the axial noise."""
    out = sigma
    if e.excess_noise_strength > 0.0:
        out = sigma * wp.max(1.0 + e.excess_noise_strength * (e.excess_noise_factor - 1.0), 0.0)
    if e.ambient_light_strength > 0.0:
        extra = e.ambient_light_strength * e.ambient_light_k / wp.max(amplitude, _DARKEST)
        out = wp.sqrt(out * out + extra * extra)
    return out


@wp.func
def wrong_jump(light: Light, errors: wp.vec3f, here: wp.float32) -> wp.float32:
    """Return the jump to those whole wraps at which the frequencies' distances agree best."""
    finest = wp.int32(0)
    for f in range(3):
        if f < light.frequencies and light.spans[f] < light.spans[finest]:
            finest = f
    most = wp.int32(wp.ceil(light.ambiguity / light.spans[finest]))
    best = wp.float32(_FLT_MAX)
    jump = wp.float32(0.0)
    wrap = -most
    while wrap <= most:
        first = errors[finest] + wp.float32(wrap) * light.spans[finest]
        mean = wp.float32(0.0)
        mean_jump = wp.float32(0.0)
        squares = wp.float32(0.0)
        for f in range(3):
            if f < light.frequencies:
                wrapped = wp.rint((first - errors[f]) / light.spans[f]) * light.spans[f]
                mean += light.weights[f] * (errors[f] + wrapped)
                mean_jump += light.weights[f] * wrapped
        for f in range(3):
            if f < light.frequencies:
                wrapped = wp.rint((first - errors[f]) / light.spans[f]) * light.spans[f]
                off = errors[f] + wrapped - mean
                squares += light.weights[f] * off * off
        fits = wrap == 0 or (here + mean_jump >= 0.0 and here + mean_jump < light.ambiguity)
        if fits and squares < best:
            best = squares
            jump = mean_jump
        wrap += 1
    return jump


@wp.func
def unwrapped(
    e: Effects,
    light: Light,
    shifts: wp.vec3f,
    sigma: wp.float32,
    pixel: wp.int32,
    pixels: wp.int32,
    stamp: wp.int64,
    key: wp.vec2ui,
    here: wp.float32,
) -> wp.float32:
    """Return the measured depth after unwrapping, which noise can lead astray."""
    spread = e.range_wrap_strength * sigma
    risky = wp.bool(False)
    for k in range(3):
        i = k // 2
        j = wp.min(k + 1, 2)
        if j < light.frequencies:
            both = wp.sqrt(
                light.spreads[i] * light.spreads[i] + light.spreads[j] * light.spreads[j]
            )
            if wp.abs(shifts[i] - shifts[j]) + _RARE * both * spread > light.steps[k] / 2.0:
                risky = True
    out = here
    if risky:
        errors = wp.vec3f()
        for f in range(3):
            if f < light.frequencies:
                errors[f] = shifts[f] + light.spreads[f] * spread * draw_normal(
                    f * pixels + pixel, _WRAP, stamp, key
                )
        apart = wp.bool(False)
        for k in range(3):
            i = k // 2
            j = wp.min(k + 1, 2)
            if j < light.frequencies and wp.abs(errors[i] - errors[j]) > light.steps[k] / 2.0:
                apart = True
        if apart:
            out = here + wrong_jump(light, errors, here)
    return out

"""Effects on the shift and the noise of each pixel, before edges move, as Warp kernels."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import draw_four, reflectivity_at, Surfaces
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import blocks_of, distance, Lens, OPTIONS, padded
from flexx2_sim_ros.batch.light_kernels import Phasors
from flexx2_sim_ros.batch.memory_kernels import Kept, PassImages
from flexx2_sim_ros.effects import (
    ambient_light,
    amplitude_bias,
    excess_noise,
    heavy_tails,
    warm_up_drift,
    wiggling,
)
import warp as wp

wp.set_module_options(OPTIONS)

_TAILS = wp.constant(wp.uint32(heavy_tails.HeavyTails.stream))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_harmonics = compiled(wiggling.harmonics)
_dark_bias = compiled(amplitude_bias.dark_bias)
_drift = compiled(warm_up_drift.drift)
_scaled_noise = compiled(excess_noise.scaled_noise)
_with_tails = compiled(heavy_tails.with_tails)
_with_shot_noise = compiled(ambient_light.with_shot_noise)


@wp.kernel
def wiggle(
    p: wp.array(dtype=wp.float32),
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    phasors: Phasors,
):
    """Add the harmonics of the modulation: the effect wiggling."""
    n, y, c = wp.tid()
    e = effects[first + n]
    light = lights[first + n]
    if e.wiggling_strength <= 0.0:
        return
    row = (n * lens.height + y) * lens.width
    i = padded(lens, n, y, 0)
    begin = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    f = wp.int32(0)
    while f < light.frequencies:
        turns = light.turns[f]
        shifts = f * phasors.pitch + row
        x = wp.int32(begin)
        while x < end:
            shift = at(phasors.shifts, shifts + x)
            harmonics = _harmonics(
                turns * (distance(at(p, i + x), 0.0) + shift),
                e.wiggling_a1,
                e.wiggling_b1,
                e.wiggling_a2,
                e.wiggling_b2,
                e.wiggling_a3,
                e.wiggling_b3,
                e.wiggling_a4,
                e.wiggling_b4,
            )
            put(phasors.shifts, shifts + x, shift + harmonics)
            x += stride
        f += 1


@wp.kernel
def shift_alike(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    kept: Kept,
    phasors: Phasors,
):
    """Add the shift that all frequencies have in common."""
    n, y, c = wp.tid()
    e = effects[first + n]
    light = lights[first + n]
    elapsed = wp.float32(kept.last[first + n] - kept.started[first + n]) * _PER_NANOSECOND
    same = wp.float32(e.offset_bias)
    if e.warm_up_drift_strength > 0.0:
        same += _drift(elapsed, e.warm_up_drift_bias, e.warm_up_drift_tau, e.warm_up_drift_uptime)
    own_row = ((first + n) * lens.height + y) * lens.width
    row = (n * lens.height + y) * lens.width
    spread = e.fixed_pattern_rms
    begin = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    f = wp.int32(0)
    while f < light.frequencies:
        shifts = f * phasors.pitch + row
        x = wp.int32(begin)
        while x < end:
            shift = at(phasors.shifts, shifts + x) + same
            if spread > 0.0:
                shift += spread * at(kept.grain, own_row + x)
            if e.amplitude_bias_strength > 0.0:
                shift += _dark_bias(
                    at(phasors.amplitude, row + x),
                    e.amplitude_bias_intercept,
                    e.amplitude_bias_slope,
                    e.amplitude_bias_log_knee,
                    e.amplitude_bias_span,
                )
            put(phasors.shifts, shifts + x, shift)
            x += stride
        f += 1


@wp.kernel
def change_noise(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    phasors: Phasors,
    seen: PassImages,
):
    """Change sigma_z: the effects excess_noise and ambient_light."""
    n, y, c = wp.tid()
    e = effects[first + n]
    row = (n * lens.height + y) * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        sigma = at(seen.expected, row + x)
        if e.excess_noise_strength > 0.0:
            sigma = _scaled_noise(sigma, e.excess_noise_factor)
        if e.ambient_light_strength > 0.0:
            sigma = _with_shot_noise(
                sigma,
                at(phasors.amplitude, row + x),
                reflectivity_at(surfaces, lens, n, y, x),
                e.ambient_light_k,
                e.ambient_light_reflected,
            )
        put(seen.expected, row + x, sigma)
        x += stride


@wp.kernel
def widen_tails(
    pixels: wp.int32,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    seen: PassImages,
):
    """Change normals, ``chunk`` blocks of four a thread: the effect heavy_tails."""
    n, c = wp.tid()
    share = effects[first + n].heavy_tails_share
    width = effects[first + n].heavy_tails_width
    if share <= 0.0:
        return
    key = keys[first + n]
    stamp = stamps[first + n]
    blocks = blocks_of(pixels)
    block = c * chunk
    end = wp.min(block + chunk, blocks)
    while block < end:
        chances = draw_four(block, _TAILS, stamp, key)
        i = 4 * (n * blocks + block)
        put(seen.normals, i, _with_tails(at(seen.normals, i), chances[0], share, width))
        put(seen.normals, i + 1, _with_tails(at(seen.normals, i + 1), chances[1], share, width))
        put(seen.normals, i + 2, _with_tails(at(seen.normals, i + 2), chances[2], share, width))
        put(seen.normals, i + 3, _with_tails(at(seen.normals, i + 3), chances[3], share, width))
        block += 1

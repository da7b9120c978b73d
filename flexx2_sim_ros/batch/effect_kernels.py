"""
Effects on measured depth, as Warp kernels: what begins a frame, and from light to its end.

In the order of light, as `camera.stages`, which says what happens where. What is seen of a
displaced surface is computed at the pixel that it comes from, with the random numbers of the pixel
that sees it.
"""

import math
from typing import Any

from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import arccos, compiled, log_from_zero
from flexx2_sim_ros.batch.effect_formulas import draw_four, unwrapped, wrapped
from flexx2_sim_ros.batch.frame import (
    blocks_of,
    Frame,
    NO,
    of_pixels,
    OPTIONS,
    Own,
    own_of,
    padded,
    place,
    YES,
)
from flexx2_sim_ros.batch.kernels import distance, source_of
from flexx2_sim_ros.effects import Effect, quantisation, spatial_filter, temporal_filter
from flexx2_sim_ros.effects.grazing_dropout import GrazingDropout, survives_grazing
from flexx2_sim_ros.effects.low_signal_dropout import LowSignalDropout, survives_darkness
from flexx2_sim_ros.effects.random_dropout import RandomDropout, survives_chance
from flexx2_sim_ros.effects.saturation import Saturation, specular_gain, survives_light
from flexx2_sim_ros.formulas import pixels as pixel_formulas
import warp as wp

wp.set_module_options(OPTIONS)

_NAN = wp.constant(wp.float32(math.nan))
_FLT_MAX = wp.constant(wp.float32(3.4028235e38))

_measured = compiled(pixel_formulas.measured)
_kept_within = compiled(pixel_formulas.kept_within)
_mixed_with_alike = compiled(spatial_filter.mixed_with_alike)
_filtered = compiled(temporal_filter.filtered)
_stored = compiled(quantisation.stored)
_survives_darkness = compiled(survives_darkness)
_survives_grazing = compiled(survives_grazing)
_survives_chance = compiled(survives_chance)
_specular_gain = compiled(specular_gain)
_survives_light = compiled(survives_light)

LOSES: dict[str, Any] = {}  # the kernel of each effect, in the order of light


@wp.kernel
def begin(f: Frame):
    """Register a new frame; a stamp earlier than the latest one starts the environment again."""
    n = wp.tid()
    stamp = f.stamps[n]
    f.is_first[n] = NO
    if f.is_due[n] == NO:
        return
    if f.was_reset[n] == YES or stamp < f.last[n]:
        f.is_first[n] = YES
        f.started[n] = stamp
    f.was_reset[n] = NO
    f.before[n] = f.last[n]
    f.last[n] = stamp


@of_pixels(launch_bounds=(256, 4))  # docs/batch.md#on-a-gpu
def measure(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write measured depth, and what later kernels need to know of what is seen."""
    pixels = f.lens.height * f.lens.width
    pixel = y * f.lens.width + x
    here = n * pixels + pixel
    source = source_of(f.moved, f.lens, n, y, x)
    there = place(f.lens, n, source[0], source[1])
    z = distance(at(f.surfaces.p, padded(f.lens, n, source[0], source[1])), _NAN)
    shifts = wp.vec3f()
    for k in range(3):
        if k < own.light.frequencies:
            shifts[k] = at(f.shifts, k * f.pitch + there)
    sigma = at(f.expected, there)
    normal = at(f.normals, n * blocks_of(pixels) * 4 + pixel)
    wraps = own.effects.range_wrap_strength > 0.0
    low = wp.where(wraps, 0.0, own.noise.range_min)
    high = wp.where(wraps, _FLT_MAX, own.noise.range_max)
    value = _measured(z + wp.dot(own.light.weights, shifts), sigma, normal, low, high)
    if wraps and value == value:
        value = unwrapped(own, shifts, sigma, pixel, pixels, value)
        value = wrapped(own, z, pixel, value)
    put(f.measured, here, _kept_within(value, own.noise.range_min, own.noise.range_max))
    put(f.sigma, here, sigma)
    put(f.cosine, here, at(f.facing, there))
    put(f.signal, here, at(f.amplitude, there))
    put(f.depth, here, z)


@of_pixels()
def filter_neighbours(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Mix every pixel with those neighbours that are alike: the effect spatial_filter."""
    height, width = f.lens.height, f.lens.width
    pixel = place(f.lens, n, y, x)
    out = at(f.measured, pixel)
    if own.effects.spatial_filter_strength > 0.0:
        limit = own.effects.spatial_filter_gate * at(f.sigma, pixel)
        mix = own.effects.spatial_filter_mix
        out = _mixed_with_alike(f.measured, n * height * width, height, width, y, x, limit, mix)
    put(f.filtered, pixel, out)


@wp.func
def _filters_in_time(f: Frame, own: Own) -> wp.bool:
    return own.effects.temporal_filter_strength > 0.0 and own.is_due


@of_pixels(when=_filters_in_time)
def filter_in_time(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Mix every pixel with the frame before: the effect temporal_filter."""
    pixel = place(f.lens, n, y, x)
    kept = place(f.lens, own.env, y, x)
    value = at(f.filtered, pixel)
    if not own.is_first:
        share = own.effects.temporal_filter_share
        value = _filtered(value, at(f.kept, kept), at(f.sigma, pixel), share)
    put(f.filtered, pixel, value)
    put(f.kept, kept, value)


@of_pixels()
def finish(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the frame after the effect quantisation."""
    value = at(f.filtered, place(f.lens, n, y, x))
    if own.effects.quantisation_strength > 0.0:
        value = _stored(value, own.effects.quantisation_step)
        value = _kept_within(value, own.noise.range_min, own.noise.range_max)
    put(f.out, place(f.lens, own.env, y, x), wp.where(value == value, value, f.lens.invalid))


@wp.func
def draw_between(
    f: Frame, own: Own, begin: wp.int32, end: wp.int32, base: wp.int32, stream: wp.uint32
) -> wp.int32:
    """Write the random numbers of pixels from begin to end, in whole blocks of four."""
    block = begin / 4
    last = (end + 3) / 4
    while block < last:
        four = draw_four(block, stream, own.stamp, own.key)
        i = base + 4 * block
        put(f.chances, i, four[0])
        put(f.chances, i + 1, four[1])
        put(f.chances, i + 2, four[2])
        put(f.chances, i + 3, four[3])
        block += 1
    return last


def _kernel(effect: type[Effect], strength_of: Any, chance_of: Any) -> None:
    # Makes the kernel of an effect, which compares each pixel's chance to stay valid with its
    # random number.
    stream = wp.constant(wp.uint32(effect.stream))

    @wp.kernel
    def lose(f: Frame):
        n, y, c = wp.tid()
        own = own_of(f, n)
        if strength_of(own) <= 0.0:
            return
        pixels = f.lens.height * f.lens.width
        drawn = n * blocks_of(pixels) * 4
        x = y * f.lens.width + c * f.chunk
        end = wp.min(x + f.chunk, (y + 1) * f.lens.width)
        draw_between(f, own, x, end, drawn, stream)
        while x < end:
            lost = at(f.chances, drawn + x) > chance_of(f, own, n * pixels + x)
            i = own.env * pixels + x
            put(f.out, i, wp.where(lost, f.lens.invalid, at(f.out, i)))
            x += 1

    LOSES[effect.name] = lose


@wp.func
def _darkness_strength(own: Own) -> wp.float32:
    return own.effects.low_signal_dropout_strength


@wp.func
def _chance_in_darkness(f: Frame, own: Own, i: wp.int32) -> wp.float32:
    return _survives_darkness(
        log_from_zero(at(f.signal, i)),
        own.effects.low_signal_dropout_log_half,
        own.effects.low_signal_dropout_slope,
        own.effects.low_signal_dropout_strength,
    )


@wp.func
def _grazing_strength(own: Own) -> wp.float32:
    return own.effects.grazing_dropout_strength


@wp.func
def _chance_at_grazing(f: Frame, own: Own, i: wp.int32) -> wp.float32:
    return _survives_grazing(
        arccos(at(f.cosine, i)),
        at(f.depth, i),
        own.effects.grazing_dropout_half,
        own.effects.grazing_dropout_width,
        own.effects.grazing_dropout_distance,
        own.effects.grazing_dropout_strength,
    )


@wp.func
def _saturation_strength(own: Own) -> wp.float32:
    return own.effects.saturation_strength


@wp.func
def _chance_in_light(f: Frame, own: Own, i: wp.int32) -> wp.float32:
    incidence = arccos(at(f.cosine, i))
    return _survives_light(
        log_from_zero(at(f.signal, i)),
        _specular_gain(incidence, own.effects.saturation_gloss, own.effects.saturation_lobe),
        own.effects.saturation_log_half,
        own.effects.saturation_slope,
        own.effects.saturation_strength,
    )


@wp.func
def _random_strength(own: Own) -> wp.float32:
    return own.effects.random_dropout_strength


@wp.func
def _chance_at_random(f: Frame, own: Own, i: wp.int32) -> wp.float32:
    return _survives_chance(own.effects.random_dropout_share)


_kernel(LowSignalDropout, _darkness_strength, _chance_in_darkness)
_kernel(GrazingDropout, _grazing_strength, _chance_at_grazing)
_kernel(Saturation, _saturation_strength, _chance_in_light)
_kernel(RandomDropout, _random_strength, _chance_at_random)

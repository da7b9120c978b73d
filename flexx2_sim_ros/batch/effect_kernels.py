"""
Effects on measured depth, as Warp kernels: from the light of each pixel to the finished frame.

In the order of light, as `camera.stages`, which says what happens where. What is seen of a
displaced surface is computed at the pixel that it comes from, with the random numbers of the pixel
that sees it.
"""

import math

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import unwrapped, wrapped
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import (
    blocks_of,
    distance,
    Lens,
    Noise,
    OPTIONS,
    padded,
    source_of,
)
from flexx2_sim_ros.batch.light_kernels import Phasors
from flexx2_sim_ros.batch.memory_kernels import Kept, PassImages
from flexx2_sim_ros.effects import quantisation, spatial_filter, temporal_filter
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


@wp.kernel(launch_bounds=(256, 4))  # docs/batch.md#on-a-gpu
def measure(
    p: wp.array(dtype=wp.float32),
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    noises: wp.array(dtype=Noise),
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    moved: wp.array(dtype=wp.uint16),
    phasors: Phasors,
    seen: PassImages,
):
    """Write measured depth, and what later kernels need to know of what is seen."""
    n, y, c = wp.tid()
    noise = noises[first + n]
    e = effects[first + n]
    light = lights[first + n]
    pixels = lens.height * lens.width
    wraps = e.range_wrap_strength > 0.0
    low = wp.where(wraps, 0.0, noise.range_min)
    high = wp.where(wraps, _FLT_MAX, noise.range_max)
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        pixel = y * lens.width + x
        here = n * pixels + pixel
        source = source_of(moved, lens, n, y, x)
        there = (n * lens.height + source[0]) * lens.width + source[1]
        z = distance(at(p, padded(lens, n, source[0], source[1])), _NAN)
        shifts = wp.vec3f()
        for f in range(3):
            if f < light.frequencies:
                shifts[f] = at(phasors.shifts, f * phasors.pitch + there)
        sigma = at(seen.expected, there)
        normal = at(seen.normals, n * blocks_of(pixels) * 4 + pixel)
        value = _measured(z + wp.dot(light.weights, shifts), sigma, normal, low, high)
        if wraps and value == value:
            key = keys[first + n]
            stamp = stamps[first + n]
            value = unwrapped(e, light, shifts, sigma, pixel, pixels, stamp, key, value)
            value = wrapped(e, light, z, noise, pixel, stamp, key, value)
        put(seen.measured, here, _kept_within(value, noise.range_min, noise.range_max))
        put(seen.sigma, here, sigma)
        put(seen.cosine, here, at(seen.facing, there))
        put(seen.amplitude, here, at(phasors.amplitude, there))
        put(seen.depth, here, z)
        x += stride


@wp.kernel
def filter_neighbours(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    seen: PassImages,
):
    """Mix every pixel with those neighbours that are alike: the effect spatial_filter."""
    n, y, c = wp.tid()
    e = effects[first + n]
    frame = n * lens.height * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        pixel = frame + y * lens.width + x
        out = at(seen.measured, pixel)
        if e.spatial_filter_strength > 0.0:
            limit = e.spatial_filter_gate * at(seen.sigma, pixel)
            out = _mixed_with_alike(
                seen.measured, frame, lens.height, lens.width, y, x, limit, e.spatial_filter_mix
            )
        put(seen.filtered, pixel, out)
        x += stride


@wp.kernel
def filter_in_time(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    kept: Kept,
    filtered: wp.array(dtype=wp.float32),
    seen: PassImages,
):
    """Mix every pixel of ``filtered`` with the frame before: the effect temporal_filter."""
    n, y, c = wp.tid()
    e = effects[first + n]
    if e.temporal_filter_strength <= 0.0 or kept.is_due[first + n] == wp.uint8(0):
        return
    here = (n * lens.height + y) * lens.width
    own = ((first + n) * lens.height + y) * lens.width
    begin = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    x = wp.int32(begin)
    if kept.is_first[first + n] == wp.uint8(0):
        while x < end:
            before = at(kept.measured, own + x)
            sigma = at(seen.sigma, here + x)
            value = _filtered(at(filtered, here + x), before, sigma, e.temporal_filter_share)
            put(filtered, here + x, value)
            x += stride
    x = wp.int32(begin)
    while x < end:
        put(kept.measured, own + x, at(filtered, here + x))
        x += stride


@wp.kernel
def finish(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    noises: wp.array(dtype=Noise),
    effects: wp.array(dtype=Effects),
    filtered: wp.array(dtype=wp.float32),
    out: wp.array(dtype=wp.float32),
):
    """Write the frame after the effect quantisation."""
    n, y, c = wp.tid()
    noise = noises[first + n]
    step = effects[first + n].quantisation_step
    here = (n * lens.height + y) * lens.width
    target = ((first + n) * lens.height + y) * lens.width
    begin = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    x = wp.int32(begin)
    if effects[first + n].quantisation_strength > 0.0:
        while x < end:
            value = _stored(at(filtered, here + x), step)
            value = _kept_within(value, noise.range_min, noise.range_max)
            put(out, target + x, wp.where(value == value, value, lens.invalid))
            x += stride
    while x < end:
        value = at(filtered, here + x)
        put(out, target + x, wp.where(value == value, value, lens.invalid))
        x += stride

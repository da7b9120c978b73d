"""
Effects that act on each pixel, as Warp kernels: from the surface to the finished frame.

In the order of light, as `camera.stages`, which says what happens where. What is seen of a
displaced surface is computed at the pixel that it comes from, with the random numbers of the pixel
that sees it.
"""

import math

from flexx2_sim_ros.batch.arithmetic import (
    arccos,
    AXIAL,
    counter_of,
    four_normals,
    log_from_zero,
    one_of,
)
from flexx2_sim_ros.batch.arrays import at, at_word, put, put_word
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import (
    common_shift,
    draw,
    draw_four,
    noise_at,
    reflectivity_at,
    Surfaces,
    unwrapped,
    wiggle,
    wrapped,
)
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import blocks_of, distance, Lens, Noise, OPTIONS, padded
from flexx2_sim_ros.batch.light_kernels import motion_shift, Phasors
from flexx2_sim_ros.effects import (
    between,
    grazing_dropout,
    heavy_tails,
    low_signal_dropout,
    motion_artefact,
    quantisation,
    saturation,
    spatial_filter,
    temporal_filter,
)
from flexx2_sim_ros.formulas import pixels as pixel_formulas
import warp as wp

wp.set_module_options(OPTIONS)

_DARKEST = wp.constant(wp.float32(motion_artefact.DARKEST))
_MOTION = wp.constant(wp.uint32(motion_artefact.MotionArtefact.stream))
_TAILS = wp.constant(wp.uint32(heavy_tails.HeavyTails.stream))
_LOW_SIGNAL = wp.constant(wp.uint32(low_signal_dropout.LowSignalDropout.stream))
_GRAZING = wp.constant(wp.uint32(grazing_dropout.GrazingDropout.stream))
_SATURATION = wp.constant(wp.uint32(saturation.Saturation.stream))
_NAN = wp.constant(wp.float32(math.nan))
_FLT_MAX = wp.constant(wp.float32(3.4028235e38))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_alike = compiled(between.alike)
_measured = compiled(pixel_formulas.measured)
_kept_within = compiled(pixel_formulas.kept_within)
_with_tails = compiled(heavy_tails.with_tails)
_is_alike = compiled(spatial_filter.is_alike)
_smoothed = compiled(spatial_filter.smoothed)
_filtered = compiled(temporal_filter.filtered)
_stored = compiled(quantisation.stored)
_survives_darkness = compiled(low_signal_dropout.survives_darkness)
_survives_grazing = compiled(grazing_dropout.survives_grazing)
_specular_gain = compiled(saturation.specular_gain)
_survives_light = compiled(saturation.survives_light)


@wp.struct
class Kept:
    """What is kept of every environment between frames; arrays of unused effects are empty."""

    fresh: wp.array(dtype=wp.uint8)  # 1: to start afresh with the next frame
    young: wp.array(dtype=wp.uint8)  # 1: this is the first frame
    started: wp.array(dtype=wp.int64)
    last: wp.array(dtype=wp.int64)
    before: wp.array(dtype=wp.int64)
    depth: wp.array(dtype=wp.float32)
    reflectivity: wp.array(dtype=wp.float32)
    measured: wp.array(dtype=wp.float32)
    grain: wp.array(dtype=wp.float32)


@wp.struct
class Seen:
    """Images of the pass between the kernels, flat, without borders."""

    facing: wp.array(dtype=wp.float32)  # cosine of incidence, before edges move
    expected: wp.array(dtype=wp.float32)  # sigma_z, before edges move
    normals: wp.array(dtype=wp.float32)  # whole blocks of four; empty: to be drawn
    measured: wp.array(dtype=wp.float32)
    filtered: wp.array(dtype=wp.float32)
    sigma: wp.array(dtype=wp.float32)
    cosine: wp.array(dtype=wp.float32)
    amplitude: wp.array(dtype=wp.float32)
    depth: wp.array(dtype=wp.float32)


@wp.kernel
def begin(kept: Kept, stamps: wp.array(dtype=wp.int64)):
    """Take notice of a new frame; one from before the latest is another start."""
    n = wp.tid()
    stamp = stamps[n]
    kept.young[n] = wp.uint8(0)
    if kept.fresh[n] == wp.uint8(1) or stamp < kept.last[n]:
        kept.young[n] = wp.uint8(1)
        kept.started[n] = stamp
    kept.fresh[n] = wp.uint8(0)
    kept.before[n] = kept.last[n]
    kept.last[n] = stamp


@wp.kernel
def forget(mask: wp.array(dtype=wp.bool), fresh: wp.array(dtype=wp.uint8)):
    """Start the chosen environments afresh."""
    n = wp.tid()
    if mask[n]:
        fresh[n] = wp.uint8(1)


@wp.struct
class Moving:
    """How an environment's scene moves between two frames, for the effect motion_artefact."""

    on: wp.bool
    interval: wp.float32  # seconds between the frames
    acquisition: wp.float32  # the time that all raw frames take, over the interval


@wp.struct
class Motion:
    """What of a pixel's motion its frequencies have in common."""

    on: wp.bool
    start: wp.float32
    brighter: wp.float32
    change: wp.float32


@wp.func
def moving_at(
    e: Effects, light: Light, young: wp.uint8, before: wp.int64, stamp: wp.int64
) -> Moving:
    """Return how an environment's scene moves; not at all in its first frame."""
    out = Moving()
    out.interval = wp.float32(stamp - before) * _PER_NANOSECOND
    out.on = e.motion_artefact_strength > 0.0 and young == wp.uint8(0) and out.interval > 0.0
    if out.on:
        duration = e.motion_artefact_strength * e.motion_artefact_stretch * light.acquisition
        out.acquisition = duration / out.interval
    return out


@wp.func
def motion_at(
    moving: Moving,
    z: wp.float32,
    depth_before: wp.float32,
    brighter: wp.float32,
    pixel: wp.int32,
    stamp: wp.int64,
    key: wp.vec2ui,
) -> Motion:
    """Return a pixel's motion since the frame before."""
    out = Motion()
    out.start = depth_before - z
    out.brighter = brighter
    passes = out.start == out.start and (
        brighter != 1.0 or (out.start != 0.0 and not _alike(out.start, z, moving.interval))
    )
    if passes:
        out.change = draw(pixel, _MOTION, stamp, key)
    out.on = out.start == out.start and (out.start != 0.0 or passes)
    return out


@wp.func
def shifted(
    e: Effects,
    light: Light,
    phasors: Phasors,
    source: wp.int32,
    moving: Moving,
    motion: Motion,
    z: wp.float32,
    common: wp.float32,
) -> wp.vec3f:
    """Return the shift of each frequency, from that of its light."""
    out = wp.vec3f()
    for f in range(3):
        if f < light.frequencies:
            shift = at(phasors.shifts, f * phasors.pitch + source)
            if motion.on:
                shift += motion_shift(
                    z,
                    motion.start,
                    motion.brighter,
                    motion.change,
                    moving.interval,
                    moving.acquisition,
                    e.motion_artefact_stamp_at,
                    light,
                    f,
                    shift,
                )
            if e.wiggling_strength > 0.0:
                shift += wiggle(e, light.turns[f] * (z + shift))
            out[f] = shift + common
    return out


@wp.func
def source_of(code: wp.int32, y: wp.int32, x: wp.int32) -> wp.vec2i:
    """Return row and column of the pixel whose surface another one sees, from `Images.moved`."""
    offset = (code & 255) - 128
    down = (code >> 8) & 1
    if code == 0:
        offset = 0
    return wp.vec2i(y + offset * down, x + offset * (1 - down))


@wp.kernel
def measure(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    noises: wp.array(dtype=Noise),
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    kept: Kept,
    moved: wp.array(dtype=wp.uint16),
    phasors: Phasors,
    seen: Seen,
):
    """Write measured depth, and what later kernels need to know of what is seen."""
    n, y, c = wp.tid()
    noise = noises[first + n]
    e = effects[first + n]
    light = lights[first + n]
    key = keys[first + n]
    stamp = stamps[first + n]
    pixels = lens.height * lens.width
    elapsed = wp.float32(stamp - kept.started[first + n]) * _PER_NANOSECOND
    moving = moving_at(e, light, kept.young[first + n], kept.before[first + n], stamp)
    wraps = e.range_wrap_strength > 0.0
    low = wp.where(wraps, 0.0, noise.range_min)
    high = wp.where(wraps, _FLT_MAX, noise.range_max)
    drawn = n * blocks_of(pixels) * 4
    block = wp.int32(-1)
    normals = wp.vec4f()
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        pixel = y * lens.width + x
        code = wp.int32(at_word(moved, n * pixels + pixel))
        sy = wp.int32(y)
        sx = wp.int32(x)
        if code != 0:
            put_word(moved, n * pixels + pixel, wp.uint16(0))
            source = source_of(code, y, x)
            sy = source[0]
            sx = source[1]
        seen_pixel = sy * lens.width + sx
        place = (first + n) * pixels + seen_pixel
        inverse = at(surfaces.p, padded(lens, n, sy, sx))
        cosine = at(seen.facing, n * pixels + seen_pixel)
        z = distance(inverse, _NAN)
        amplitude = at(phasors.amplitude, n * pixels + seen_pixel)
        motion = Motion()
        if moving.on:
            rho = reflectivity_at(surfaces, lens, n, sy, sx)
            brighter = at(kept.reflectivity, place) / wp.max(rho, _DARKEST)
            motion = motion_at(moving, z, at(kept.depth, place), brighter, seen_pixel, stamp, key)
        grain = wp.float32(0.0)
        if e.fixed_pattern_strength > 0.0:
            grain = at(kept.grain, place)
        common = common_shift(e, grain, amplitude, elapsed)
        shifts = shifted(e, light, phasors, n * pixels + seen_pixel, moving, motion, z, common)
        sigma = noise_at(e, at(seen.expected, n * pixels + seen_pixel), amplitude)
        normal = wp.float32(0.0)
        if seen.normals.shape[0] > 0:
            normal = at(seen.normals, drawn + pixel)
        else:
            if pixel / 4 != block:
                block = pixel / 4
                normals = four_normals(counter_of(block, AXIAL, stamp), key)
            normal = one_of(normals, pixel % 4)
        if e.heavy_tails_share > 0.0:
            chance = draw(pixel, _TAILS, stamp, key)
            normal = _with_tails(normal, chance, e.heavy_tails_share, e.heavy_tails_width)
        value = _measured(z + wp.dot(light.weights, shifts), sigma, normal, low, high)
        if wraps and value == value:
            value = unwrapped(e, light, shifts, sigma, pixel, pixels, stamp, key, value)
            value = wrapped(e, light, z, noise, pixel, stamp, key, value)
        put(
            seen.measured,
            n * pixels + pixel,
            _kept_within(value, noise.range_min, noise.range_max),
        )
        put(seen.sigma, n * pixels + pixel, sigma)
        put(seen.cosine, n * pixels + pixel, cosine)
        put(seen.amplitude, n * pixels + pixel, amplitude)
        put(seen.depth, n * pixels + pixel, z)
        x += 1


@wp.kernel
def filter_neighbours(
    lens: Lens, first: wp.int32, chunk: wp.int32, effects: wp.array(dtype=Effects), seen: Seen
):
    """Mix every pixel with those neighbours that are alike: the effect spatial_filter."""
    n, y, c = wp.tid()
    e = effects[first + n]
    frame = n * lens.height * lens.width
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        pixel = frame + y * lens.width + x
        here = at(seen.measured, pixel)
        out = wp.float32(here)
        if e.spatial_filter_strength > 0.0:
            limit = e.spatial_filter_gate * at(seen.sigma, pixel)
            total = wp.float32(0.0)
            count = wp.float32(0.0)
            for k in range(9):
                yy = y + k // 3 - 1
                xx = x + k % 3 - 1
                if yy >= 0 and yy < lens.height and xx >= 0 and xx < lens.width:
                    difference = at(seen.measured, frame + yy * lens.width + xx) - here
                    if _is_alike(difference, limit):
                        total += difference
                        count += 1.0
            out = _smoothed(here, total, count, e.spatial_filter_mix)
        put(seen.filtered, pixel, out)
        x += 1


@wp.func
def too_dark(e: Effects, amplitude: wp.float32, chance: wp.float32) -> wp.bool:
    """Say whether the effect low_signal_dropout loses a pixel."""
    return chance > _survives_darkness(
        log_from_zero(amplitude),
        e.low_signal_dropout_log_half,
        e.low_signal_dropout_slope,
        e.low_signal_dropout_strength,
    )


@wp.func
def too_slanted(e: Effects, incidence: wp.float32, z: wp.float32, chance: wp.float32) -> wp.bool:
    """Say whether the effect grazing_dropout loses a pixel."""
    return chance > _survives_grazing(
        incidence,
        z,
        e.grazing_dropout_half,
        e.grazing_dropout_width,
        e.grazing_dropout_distance,
        e.grazing_dropout_strength,
    )


@wp.func
def too_bright(
    e: Effects, amplitude: wp.float32, incidence: wp.float32, chance: wp.float32
) -> wp.bool:
    """Say whether the effect saturation loses a pixel."""
    return chance > _survives_light(
        log_from_zero(amplitude),
        _specular_gain(incidence, e.saturation_gloss, e.saturation_lobe),
        e.saturation_log_half,
        e.saturation_slope,
        e.saturation_strength,
    )


@wp.kernel
def finish(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    noises: wp.array(dtype=Noise),
    effects: wp.array(dtype=Effects),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    kept: Kept,
    filtered: wp.array(dtype=wp.float32),
    seen: Seen,
    out: wp.array(dtype=wp.float32),
):
    """Write the finished frame: temporal filter, storage, dropout."""
    n, y, c = wp.tid()
    noise = noises[first + n]
    e = effects[first + n]
    key = keys[first + n]
    stamp = stamps[first + n]
    pixels = lens.height * lens.width
    block = wp.int32(-1)
    dark = wp.vec4f()
    grazing = wp.vec4f()
    bright = wp.vec4f()
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        pixel = y * lens.width + x
        if pixel / 4 != block:
            block = pixel / 4
            if e.low_signal_dropout_strength > 0.0:
                dark = draw_four(block, _LOW_SIGNAL, stamp, key)
            if e.grazing_dropout_strength > 0.0:
                grazing = draw_four(block, _GRAZING, stamp, key)
            if e.saturation_strength > 0.0:
                bright = draw_four(block, _SATURATION, stamp, key)
        place = n * pixels + pixel
        target = (first + n) * pixels + pixel
        value = at(filtered, place)
        if e.temporal_filter_strength > 0.0:
            if kept.young[first + n] == wp.uint8(0):
                value = _filtered(
                    value,
                    at(kept.measured, target),
                    at(seen.sigma, place),
                    e.temporal_filter_share,
                )
            put(kept.measured, target, value)
        if e.quantisation_strength > 0.0:
            value = _stored(value, e.quantisation_step)
            value = _kept_within(value, noise.range_min, noise.range_max)
        # Warp's `and` computes both sides: hence an `if` in an `if`.
        amplitude = at(seen.amplitude, place)
        incidence = arccos(at(seen.cosine, place))
        if e.low_signal_dropout_strength > 0.0:  # noqa: SIM102
            if too_dark(e, amplitude, one_of(dark, pixel % 4)):
                value = _NAN
        if e.grazing_dropout_strength > 0.0:  # noqa: SIM102
            z = at(seen.depth, place)
            if too_slanted(e, incidence, z, one_of(grazing, pixel % 4)):
                value = _NAN
        if e.saturation_strength > 0.0:  # noqa: SIM102
            if too_bright(e, amplitude, incidence, one_of(bright, pixel % 4)):
                value = _NAN
        put(out, target, wp.where(value == value, value, lens.invalid))
        x += 1


@wp.kernel
def keep_surfaces(surfaces: Surfaces, lens: Lens, first: wp.int32, chunk: wp.int32, kept: Kept):
    """Remember what is seen, for the motion until the next frame."""
    n, y, c = wp.tid()
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    row = ((first + n) * lens.height + y) * lens.width
    while x < end:
        put(kept.depth, row + x, distance(at(surfaces.p, padded(lens, n, y, x)), _NAN))
        put(kept.reflectivity, row + x, wp.max(reflectivity_at(surfaces, lens, n, y, x), _DARKEST))
        x += 1

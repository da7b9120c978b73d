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
    exp,
    four_normals,
    log,
    one_of,
    power,
)
from flexx2_sim_ros.batch.arrays import at, at_word, put, put_word
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import (
    common_shift,
    draw,
    noise_at,
    reflectivity_at,
    Surfaces,
    unwrapped,
    wiggle,
)
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import blocks_of, Lens, Noise, OPTIONS, padded
from flexx2_sim_ros.batch.light_kernels import motion_shift, Phasors
from flexx2_sim_ros.effects import between
from flexx2_sim_ros.effects.grazing_dropout import GrazingDropout
from flexx2_sim_ros.effects.heavy_tails import HeavyTails
from flexx2_sim_ros.effects.low_signal_dropout import LowSignalDropout
from flexx2_sim_ros.effects.motion_artefact import DARKEST, MotionArtefact
from flexx2_sim_ros.effects.range_wrap import RangeWrap
from flexx2_sim_ros.effects.saturation import Saturation
from flexx2_sim_ros.effects.temporal_filter import RESET_SIGMAS
import warp as wp

wp.set_module_options(OPTIONS)

_DARKEST = wp.constant(wp.float32(DARKEST))
_MOTION = wp.constant(wp.uint32(MotionArtefact.stream))
_TAILS = wp.constant(wp.uint32(HeavyTails.stream))
_WRAP_SHARE = wp.constant(wp.uint32(RangeWrap.share_stream))
_LOW_SIGNAL = wp.constant(wp.uint32(LowSignalDropout.stream))
_GRAZING = wp.constant(wp.uint32(GrazingDropout.stream))
_SATURATION = wp.constant(wp.uint32(Saturation.stream))
_NAN = wp.constant(wp.float32(math.nan))
_FLT_MAX = wp.constant(wp.float32(3.4028235e38))
_DEGREES = wp.constant(wp.float32(180.0 / math.pi))
_RADIANS = wp.constant(wp.float32(math.pi / 180.0))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))
_RESET_SIGMAS = wp.constant(wp.float32(RESET_SIGMAS))

_alike = compiled(between.alike)


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


@wp.func
def inside(value: wp.float32, noise: Noise) -> wp.float32:
    """Return a depth, NaN outside the mode's range."""
    return wp.where(value >= noise.range_min and value <= noise.range_max, value, _NAN)


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
    interval = wp.float32(stamp - kept.before[first + n]) * _PER_NANOSECOND
    moves = (
        e.motion_artefact_strength > 0.0
        and kept.young[first + n] == wp.uint8(0)
        and interval > 0.0
    )
    duration = e.motion_artefact_strength * e.motion_artefact_stretch * light.acquisition
    wraps = e.range_wrap_strength > 0.0
    low = wp.where(wraps, 0.0, noise.range_min)
    high = wp.where(wraps, _FLT_MAX, noise.range_max)
    drawn = n * blocks_of(pixels) * 4
    block = wp.int32(-1)
    four = wp.vec4f()
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        pixel = y * lens.width + x
        code = wp.int32(at_word(moved, n * pixels + pixel))
        sy = wp.int32(y)
        sx = wp.int32(x)
        if code != 0:
            put_word(moved, n * pixels + pixel, wp.uint16(0))
            offset = (code & 255) - 128
            if ((code >> 8) & 1) == 1:
                sy = y + offset
            else:
                sx = x + offset
        source = (n * lens.height + sy) * lens.width + sx
        inverse = at(surfaces.p, padded(lens, n, sy, sx))
        cosine = at(seen.facing, source)
        sigma = at(seen.expected, source)
        z = wp.where(inverse > 0.0, 1.0 / inverse, _NAN)
        amplitude = at(phasors.amplitude, source)
        shifts = wp.vec3f()
        start = wp.float32(0.0)
        brighter = wp.float32(1.0)
        if moves:
            place = (first + n) * pixels + sy * lens.width + sx
            start = at(kept.depth, place) - z
            brighter = at(kept.reflectivity, place) / wp.max(
                reflectivity_at(surfaces, lens, n, sy, sx), _DARKEST
            )
        passes = start == start and (
            brighter != 1.0 or (start != 0.0 and not _alike(start, z, interval))
        )
        change = wp.float32(0.0)
        if passes:
            change = draw(sy * lens.width + sx, _MOTION, stamp, key)
        grain = wp.float32(0.0)
        if e.fixed_pattern_strength > 0.0:
            grain = at(kept.grain, (first + n) * pixels + sy * lens.width + sx)
        common = common_shift(e, grain, amplitude, elapsed)
        total = wp.float32(0.0)
        for f in range(3):
            if f < light.frequencies:
                shift = at(phasors.shifts, f * phasors.pitch + source)
                if moves and start == start and (start != 0.0 or passes):
                    shift += motion_shift(
                        z,
                        start,
                        brighter,
                        change,
                        interval,
                        duration / interval,
                        e.motion_artefact_stamp_at,
                        light,
                        f,
                        shift,
                    )
                if e.wiggling_strength > 0.0:
                    shift += wiggle(e, light.turns[f] * (z + shift))
                shift += common
                shifts[f] = shift
                total += light.weights[f] * shift
        sigma = noise_at(e, sigma, amplitude)
        normal = wp.float32(0.0)
        if seen.normals.shape[0] > 0:
            normal = at(seen.normals, drawn + pixel)
        else:
            if pixel / 4 != block:
                block = pixel / 4
                four = four_normals(counter_of(block, AXIAL, stamp), key)
            normal = one_of(four, pixel % 4)
        tails = e.heavy_tails_strength * e.heavy_tails_share
        if tails > 0.0 and draw(pixel, _TAILS, stamp, key) <= tails:
            normal = normal * e.heavy_tails_width
        here = z + total
        value = here + sigma * normal
        value = wp.where(here >= low and here <= high, value, _NAN)
        if wraps and value == value:
            if light.frequencies > 1:
                value = unwrapped(e, light, shifts, sigma, pixel, pixels, stamp, key, value)
            if value < 0.0 or value >= light.ambiguity or z > noise.range_max:
                wraps_whole = wp.floor(value / light.ambiguity)
                share = wp.min(e.range_wrap_strength * e.range_wrap_share, 1.0)
                noticed = draw(pixel, _WRAP_SHARE, stamp, key) > share
                value = value - wraps_whole * light.ambiguity
                if noticed or wraps_whole == 0.0:
                    value = _NAN
        put(seen.measured, n * pixels + pixel, inside(value, noise))
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
    mix = wp.min(e.spatial_filter_strength * e.spatial_filter_mix, 1.0)
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
                    if wp.abs(difference) <= limit:  # never true of NaN
                        total += difference
                        count += 1.0
            if count > 0.0:
                out = here + mix * total / count
        put(seen.filtered, pixel, out)
        x += 1


@wp.func
def lost(logit: wp.float32, strength: wp.float32, chance: wp.float32) -> wp.bool:
    """Say whether a pixel is lost: with 1 - (1 - p)^strength, p a logistic."""
    return chance > power(1.0 + exp(logit), -strength)


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
    share = wp.min(e.temporal_filter_strength * e.temporal_filter_share, 0.98)
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        pixel = y * lens.width + x
        place = n * pixels + pixel
        target = (first + n) * pixels + pixel
        value = at(filtered, place)
        amplitude = wp.max(at(seen.amplitude, place), 1.0e-37)
        if e.temporal_filter_strength > 0.0:
            if kept.young[first + n] == wp.uint8(0):
                change = at(kept.measured, target) - value
                if wp.abs(change) < _RESET_SIGMAS * at(seen.sigma, place):
                    value = value + share * change
            put(kept.measured, target, value)
        if e.quantisation_strength > 0.0:
            step = e.quantisation_strength * e.quantisation_step
            value = inside(wp.rint(value / step) * step, noise)
        if e.low_signal_dropout_strength > 0.0:
            logit = -e.low_signal_dropout_slope * (log(amplitude) - log(e.low_signal_dropout_half))
            if lost(logit, e.low_signal_dropout_strength, draw(pixel, _LOW_SIGNAL, stamp, key)):
                value = _NAN
        theta = arccos(at(seen.cosine, place))
        if e.grazing_dropout_strength > 0.0:
            logit = (theta * _DEGREES - e.grazing_dropout_half_deg) / e.grazing_dropout_width_deg
            logit += e.grazing_dropout_distance * log(wp.max(at(seen.depth, place), 1.0e-37))
            if lost(logit, e.grazing_dropout_strength, draw(pixel, _GRAZING, stamp, key)):
                value = _NAN
        if e.saturation_strength > 0.0:
            lobe = theta / (e.saturation_lobe_deg * _RADIANS)
            gain = log(1.0 + e.saturation_gloss * exp(-lobe * lobe))
            logit = e.saturation_slope * (log(amplitude) - log(e.saturation_half) + gain)
            if lost(logit, e.saturation_strength, draw(pixel, _SATURATION, stamp, key)):
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
        inverse = at(surfaces.p, padded(lens, n, y, x))
        put(kept.depth, row + x, wp.where(inverse > 0.0, 1.0 / inverse, _NAN))
        put(kept.reflectivity, row + x, wp.max(reflectivity_at(surfaces, lens, n, y, x), _DARKEST))
        x += 1

"""Effects that lose pixels of the finished frame, as Warp kernels."""

from typing import Any

from flexx2_sim_ros.batch.arithmetic import arccos, log_from_zero
from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import draw_four
from flexx2_sim_ros.batch.effect_tables import Effects
from flexx2_sim_ros.batch.kernels import blocks_of, Lens, OPTIONS
from flexx2_sim_ros.batch.memory_kernels import PassImages
from flexx2_sim_ros.effects import grazing_dropout, low_signal_dropout, random_dropout, saturation
import warp as wp

wp.set_module_options(OPTIONS)

_LOW_SIGNAL = wp.constant(wp.uint32(low_signal_dropout.LowSignalDropout.stream))
_GRAZING = wp.constant(wp.uint32(grazing_dropout.GrazingDropout.stream))
_RANDOM = wp.constant(wp.uint32(random_dropout.RandomDropout.stream))
_SATURATION = wp.constant(wp.uint32(saturation.Saturation.stream))

_survives_darkness = compiled(low_signal_dropout.survives_darkness)
_survives_grazing = compiled(grazing_dropout.survives_grazing)
_survives_chance = compiled(random_dropout.survives_chance)
_specular_gain = compiled(saturation.specular_gain)
_survives_light = compiled(saturation.survives_light)


@wp.func
def draw_between(
    begin: wp.int32,
    end: wp.int32,
    base: wp.int32,
    stream: wp.uint32,
    stamp: wp.int64,
    key: wp.vec2ui,
    out: wp.array(dtype=wp.float32),
) -> wp.int32:
    """Write the random numbers of pixels from begin to end, in whole blocks of four."""
    block = begin / 4
    last = (end + 3) / 4
    while block < last:
        four = draw_four(block, stream, stamp, key)
        i = base + 4 * block
        put(out, i, four[0])
        put(out, i + 1, four[1])
        put(out, i + 2, four[2])
        put(out, i + 3, four[3])
        block += 1
    return last


@wp.func
def _darkness_strength(e: Effects) -> wp.float32:
    return e.low_signal_dropout_strength


@wp.func
def _chance_in_darkness(e: Effects, seen: PassImages, i: wp.int32) -> wp.float32:
    return _survives_darkness(
        log_from_zero(at(seen.amplitude, i)),
        e.low_signal_dropout_log_half,
        e.low_signal_dropout_slope,
        e.low_signal_dropout_strength,
    )


@wp.func
def _grazing_strength(e: Effects) -> wp.float32:
    return e.grazing_dropout_strength


@wp.func
def _chance_at_grazing(e: Effects, seen: PassImages, i: wp.int32) -> wp.float32:
    return _survives_grazing(
        arccos(at(seen.cosine, i)),
        at(seen.depth, i),
        e.grazing_dropout_half,
        e.grazing_dropout_width,
        e.grazing_dropout_distance,
        e.grazing_dropout_strength,
    )


@wp.func
def _random_strength(e: Effects) -> wp.float32:
    return e.random_dropout_strength


@wp.func
def _chance_at_random(e: Effects, seen: PassImages, i: wp.int32) -> wp.float32:
    return _survives_chance(e.random_dropout_share)


@wp.func
def _saturation_strength(e: Effects) -> wp.float32:
    return e.saturation_strength


@wp.func
def _chance_in_light(e: Effects, seen: PassImages, i: wp.int32) -> wp.float32:
    incidence = arccos(at(seen.cosine, i))
    return _survives_light(
        log_from_zero(at(seen.amplitude, i)),
        _specular_gain(incidence, e.saturation_gloss, e.saturation_lobe),
        e.saturation_log_half,
        e.saturation_slope,
        e.saturation_strength,
    )


def _kernel(stream: Any, strength_of: Any, chance_of: Any) -> Any:
    # The kernel of an effect, which compares each pixel's chance to stay valid with its random
    # number. `strength_of` and `chance_of` are Warp functions of the effect's parameters.
    @wp.kernel
    def lose(
        lens: Lens,
        first: wp.int32,
        chunk: wp.int32,
        effects: wp.array(dtype=Effects),
        keys: wp.array(dtype=wp.vec2ui),
        stamps: wp.array(dtype=wp.int64),
        seen: PassImages,
        out: wp.array(dtype=wp.float32),
    ):
        n, y, c = wp.tid()
        e = effects[first + n]
        if strength_of(e) <= 0.0:
            return
        pixels = lens.height * lens.width
        drawn = n * blocks_of(pixels) * 4
        x = y * lens.width + c * chunk
        end = wp.min(x + chunk, (y + 1) * lens.width)
        draw_between(x, end, drawn, stream, stamps[first + n], keys[first + n], seen.chances)
        while x < end:
            survives = chance_of(e, seen, n * pixels + x)
            i = (first + n) * pixels + x
            put(out, i, wp.where(at(seen.chances, drawn + x) > survives, lens.invalid, at(out, i)))
            x += 1

    return lose


lose_dark = _kernel(_LOW_SIGNAL, _darkness_strength, _chance_in_darkness)
lose_slanted = _kernel(_GRAZING, _grazing_strength, _chance_at_grazing)
lose_at_random = _kernel(_RANDOM, _random_strength, _chance_at_random)
lose_bright = _kernel(_SATURATION, _saturation_strength, _chance_in_light)

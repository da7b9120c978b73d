"""Effects that lose pixels of the finished frame, as Warp kernels."""

from flexx2_sim_ros.batch.arithmetic import arccos, log_from_zero
from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import draw_four
from flexx2_sim_ros.batch.effect_tables import Effects
from flexx2_sim_ros.batch.kernels import blocks_of, Lens, OPTIONS
from flexx2_sim_ros.batch.memory_kernels import Seen
from flexx2_sim_ros.effects import grazing_dropout, low_signal_dropout, saturation
import warp as wp

wp.set_module_options(OPTIONS)

_LOW_SIGNAL = wp.constant(wp.uint32(low_signal_dropout.LowSignalDropout.stream))
_GRAZING = wp.constant(wp.uint32(grazing_dropout.GrazingDropout.stream))
_SATURATION = wp.constant(wp.uint32(saturation.Saturation.stream))

_survives_darkness = compiled(low_signal_dropout.survives_darkness)
_survives_grazing = compiled(grazing_dropout.survives_grazing)
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


@wp.kernel
def lose_dark(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    seen: Seen,
    out: wp.array(dtype=wp.float32),
):
    """Lose pixels with little light: the effect low_signal_dropout."""
    n, y, c = wp.tid()
    e = effects[first + n]
    if e.low_signal_dropout_strength <= 0.0:
        return
    pixels = lens.height * lens.width
    drawn = n * blocks_of(pixels) * 4
    x = y * lens.width + c * chunk
    end = wp.min(x + chunk, (y + 1) * lens.width)
    draw_between(x, end, drawn, _LOW_SIGNAL, stamps[first + n], keys[first + n], seen.chances)
    while x < end:
        survives = _survives_darkness(
            log_from_zero(at(seen.amplitude, n * pixels + x)),
            e.low_signal_dropout_log_half,
            e.low_signal_dropout_slope,
            e.low_signal_dropout_strength,
        )
        i = (first + n) * pixels + x
        put(out, i, wp.where(at(seen.chances, drawn + x) > survives, lens.invalid, at(out, i)))
        x += 1


@wp.kernel
def lose_slanted(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    seen: Seen,
    out: wp.array(dtype=wp.float32),
):
    """Lose pixels of slanted surfaces: the effect grazing_dropout."""
    n, y, c = wp.tid()
    e = effects[first + n]
    if e.grazing_dropout_strength <= 0.0:
        return
    pixels = lens.height * lens.width
    drawn = n * blocks_of(pixels) * 4
    x = y * lens.width + c * chunk
    end = wp.min(x + chunk, (y + 1) * lens.width)
    draw_between(x, end, drawn, _GRAZING, stamps[first + n], keys[first + n], seen.chances)
    while x < end:
        survives = _survives_grazing(
            arccos(at(seen.cosine, n * pixels + x)),
            at(seen.depth, n * pixels + x),
            e.grazing_dropout_half,
            e.grazing_dropout_width,
            e.grazing_dropout_distance,
            e.grazing_dropout_strength,
        )
        i = (first + n) * pixels + x
        put(out, i, wp.where(at(seen.chances, drawn + x) > survives, lens.invalid, at(out, i)))
        x += 1


@wp.kernel
def lose_bright(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    seen: Seen,
    out: wp.array(dtype=wp.float32),
):
    """Lose pixels with much light: the effect saturation."""
    n, y, c = wp.tid()
    e = effects[first + n]
    if e.saturation_strength <= 0.0:
        return
    pixels = lens.height * lens.width
    drawn = n * blocks_of(pixels) * 4
    x = y * lens.width + c * chunk
    end = wp.min(x + chunk, (y + 1) * lens.width)
    draw_between(x, end, drawn, _SATURATION, stamps[first + n], keys[first + n], seen.chances)
    while x < end:
        incidence = arccos(at(seen.cosine, n * pixels + x))
        survives = _survives_light(
            log_from_zero(at(seen.amplitude, n * pixels + x)),
            _specular_gain(incidence, e.saturation_gloss, e.saturation_lobe),
            e.saturation_log_half,
            e.saturation_slope,
            e.saturation_strength,
        )
        i = (first + n) * pixels + x
        put(out, i, wp.where(at(seen.chances, drawn + x) > survives, lens.invalid, at(out, i)))
        x += 1

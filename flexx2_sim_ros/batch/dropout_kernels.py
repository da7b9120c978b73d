"""Effects that lose pixels of the finished frame, as Warp kernels."""

from typing import Any

from flexx2_sim_ros.batch.arithmetic import arccos, log_from_zero
from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import draw_four
from flexx2_sim_ros.batch.frame import blocks_of, Frame, OPTIONS, Own, own_of
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.effects.grazing_dropout import GrazingDropout, survives_grazing
from flexx2_sim_ros.effects.low_signal_dropout import LowSignalDropout, survives_darkness
from flexx2_sim_ros.effects.random_dropout import RandomDropout, survives_chance
from flexx2_sim_ros.effects.saturation import Saturation, specular_gain, survives_light
import warp as wp

wp.set_module_options(OPTIONS)

_survives_darkness = compiled(survives_darkness)
_survives_grazing = compiled(survives_grazing)
_survives_chance = compiled(survives_chance)
_specular_gain = compiled(specular_gain)
_survives_light = compiled(survives_light)

LOSES: dict[str, Any] = {}  # the kernel of each effect, in the order of light


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

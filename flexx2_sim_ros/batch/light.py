"""The light, shift and noise of each pixel's own surface, and what effects add to them."""

from collections.abc import Sequence

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.bounce import IndirectLight
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import (
    agreed,
    draw_four,
    mix_neighbours,
    near_jump,
    reflectivity_at,
    returned_light,
)
from flexx2_sim_ros.batch.effect_tables import MOST_FREQUENCIES
from flexx2_sim_ros.batch.frame import (
    blocks_of,
    Frame,
    of_frequencies,
    of_listed,
    of_pixels,
    OPTIONS,
    Own,
    own_of,
    padded,
    place,
    Surfaces,
)
from flexx2_sim_ros.batch.history import each_with, needs_of
from flexx2_sim_ros.batch.images import Images
from flexx2_sim_ros.batch.kernels import add_to_list, distance
from flexx2_sim_ros.batch.scatter import ScatteredLight
from flexx2_sim_ros.effects import (
    ambient_light,
    amplitude_bias,
    Effect,
    excess_noise,
    heavy_tails,
    phase_noise_wiggling,
    warm_up_drift,
    wiggling,
)
from flexx2_sim_ros.formulas import surfaces as surface_formulas
import warp as wp

wp.set_module_options(OPTIONS)


@of_pixels()
def find_light(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of every pixel."""
    i = place(f.lens, n, y, x)
    rho = reflectivity_at(f.surfaces, n, y, x)
    inverse = at(f.surfaces.p, padded(f.lens, n, y, x))
    put(f.amplitude, i, returned_light(rho, at(f.facing, i), inverse))


_TAILS = wp.constant(wp.uint32(heavy_tails.HeavyTails.stream))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_harmonics = compiled(wiggling.harmonics)
_dark_bias = compiled(amplitude_bias.dark_bias)
_drift = compiled(warm_up_drift.drift)
_scaled_noise = compiled(excess_noise.scaled_noise)
_with_tails = compiled(heavy_tails.with_tails)
_with_shot_noise = compiled(ambient_light.with_shot_noise)
_variance_factor = compiled(phase_noise_wiggling.variance_factor)
_surface_factor = compiled(surface_formulas.surface_factor)


@of_frequencies()
def clear_shifts(f: Frame, own: Own, k: wp.int32, n: wp.int32, y: wp.int32, x: wp.int32):
    """Begin without a shift."""
    put(f.shifts, k * f.pitch + place(f.lens, n, y, x), 0.0)


@wp.func
def is_mixed(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.bool:
    """Say whether a pixel has a return and is next to a depth jump."""
    return at(s.p, padded(s.lens, n, y, x)) > 0.0 and near_jump(s, n, y, x)


@wp.func
def mix(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of the footprint of a pixel."""
    pixel = place(f.lens, n, y, x)
    side = own.effects.flying_pixels_side
    mixed = mix_neighbours(f.surfaces, own.light, side, own.key, n, y, x)
    put(f.amplitude, pixel, mixed[3])
    z = 1.0 / at(f.surfaces.p, padded(f.lens, n, y, x))
    shifts = agreed(own.light, wp.vec3f(mixed[0], mixed[1], mixed[2]), z)
    for k in range(3):
        if k < own.light.frequencies:
            put(f.shifts, k * f.pitch + pixel, shifts[k])


@wp.func
def mixes(f: Frame, own: Own) -> wp.bool:
    """Say whether an environment has the effect flying_pixels."""
    return own.effects.flying_pixels_side > 0.0


@of_pixels(when=mixes)
def mix_rows(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of the footprints next to the depth jumps of a row. For the CPU."""
    if is_mixed(f.surfaces, n, y, x):
        mix(f, own, n, y, x)


@wp.kernel
def list_mixed(f: Frame):
    """List the pixels next to depth jumps for `mix_listed`. For CUDA."""
    n, y, c = wp.tid()
    if f.effects[f.first + n].flying_pixels_side <= 0.0:
        return
    found = wp.int32(0)
    bits = wp.int32(0)
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, f.lens.width)
    stride = stride_of(f.lens.width)
    while x < end:
        bits = bits * 2
        if is_mixed(f.surfaces, n, y, x):
            bits += 1
            found += 1
        x += stride
    last = y * f.lens.width + x - stride
    add_to_list(f, n, last, stride, bits, found)


@of_listed(when=mixes)
def mix_listed(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write the light of the footprints of the listed pixels. For CUDA: none waits for others."""
    mix(f, own, n, y, x)


@of_pixels()
def scale_by_surface(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Scale sigma_z by a factor that depends on each pixel's reflectivity."""
    i = place(f.lens, n, y, x)
    factor = _surface_factor(
        reflectivity_at(f.surfaces, n, y, x),
        at(f.facing, i),
        at(f.surfaces.p, padded(f.lens, n, y, x)),
        own.surface_noise[0],
        own.surface_noise[1],
        own.surface_noise[2],
    )
    put(f.expected, i, at(f.expected, i) * factor)


@wp.func
def _wiggles(f: Frame, own: Own) -> wp.bool:
    return own.effects.wiggling_strength > 0.0


@of_frequencies(when=_wiggles)
def wiggle(f: Frame, own: Own, k: wp.int32, n: wp.int32, y: wp.int32, x: wp.int32):
    """Add the harmonics of the modulation: the effect wiggling."""
    e = own.effects
    i = k * f.pitch + place(f.lens, n, y, x)
    shift = at(f.shifts, i)
    z = distance(at(f.surfaces.p, padded(f.lens, n, y, x)), 0.0)
    harmonics = _harmonics(
        own.turns * (z + shift),
        e.wiggling_a1,
        e.wiggling_b1,
        e.wiggling_a2,
        e.wiggling_b2,
        e.wiggling_a3,
        e.wiggling_b3,
        e.wiggling_a4,
        e.wiggling_b4,
    )
    put(f.shifts, i, shift + harmonics)


@of_frequencies()
def shift_alike(f: Frame, own: Own, k: wp.int32, n: wp.int32, y: wp.int32, x: wp.int32):
    """Add the shift that all frequencies have in common."""
    e = own.effects
    pixel = place(f.lens, n, y, x)
    i = k * f.pitch + pixel
    same = wp.float32(e.offset_bias)
    if e.warm_up_drift_strength > 0.0:
        elapsed = wp.float32(own.elapsed) * _PER_NANOSECOND
        same += _drift(elapsed, e.warm_up_drift_bias, e.warm_up_drift_tau, e.warm_up_drift_uptime)
    if e.depth_scale_fraction != 0.0:
        same += e.depth_scale_fraction * distance(at(f.surfaces.p, padded(f.lens, n, y, x)), 0.0)
    shift = at(f.shifts, i) + same
    if e.fixed_pattern_rms > 0.0:
        shift += e.fixed_pattern_rms * at(f.grain, place(f.lens, own.env, y, x))
    if e.amplitude_bias_strength > 0.0:
        shift += _dark_bias(
            at(f.amplitude, pixel),
            e.amplitude_bias_intercept,
            e.amplitude_bias_slope,
            e.amplitude_bias_log_knee,
            e.amplitude_bias_span,
        )
    put(f.shifts, i, shift)


@of_pixels()
def change_noise(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Change sigma_z: effects that scale it, or add to its square."""
    e = own.effects
    i = place(f.lens, n, y, x)
    sigma = at(f.expected, i)
    if e.excess_noise_strength > 0.0:
        sigma = _scaled_noise(sigma, e.excess_noise_factor)
    if e.ambient_light_strength > 0.0:
        sigma = _with_shot_noise(
            sigma,
            at(f.amplitude, i),
            reflectivity_at(f.surfaces, n, y, x),
            e.ambient_light_k,
            e.ambient_light_reflected,
        )
    if e.phase_noise_wiggling_strength > 0.0:
        z = distance(at(f.surfaces.p, padded(f.lens, n, y, x)), 0.0)
        variance = wp.float32(0.0)
        for k in range(own.light.frequencies):
            factor = _variance_factor(
                own.light.turns[k] * (z + at(f.shifts, k * f.pitch + i)),
                e.phase_noise_wiggling_sine,
                e.phase_noise_wiggling_cosine,
                e.phase_noise_wiggling_periods,
            )
            variance += own.light.weights[k] * factor
        sigma *= wp.sqrt(variance)
    put(f.expected, i, sigma)


@wp.kernel
def widen_tails(f: Frame, chunk: wp.int32):
    """Change normals, ``chunk`` blocks of four a thread: the effect heavy_tails."""
    n, c = wp.tid()
    own = own_of(f, n)
    share = own.effects.heavy_tails_share
    width = own.effects.heavy_tails_width
    if share <= 0.0:
        return
    blocks = blocks_of(f.lens.height * f.lens.width)
    block = c * chunk
    end = wp.min(block + chunk, blocks)
    while block < end:
        chances = draw_four(block, _TAILS, own.stamp, own.key)
        for k in range(4):
            i = 4 * (n * blocks + block) + k
            put(f.normals, i, _with_tails(at(f.normals, i), chances[k], share, width))
        block += 1


class PixelLight:
    """
    The light of the pixels of a pass, before effects change the phase of each frequency.

    `effects` are of every environment.
    """

    def __init__(self, effects: Sequence[Sequence[Effect]], images: Images) -> None:
        """Allocate the images."""
        self._images, device = images, images.device
        most = max(len(mode.modulation_hz) for mode in images.profile.modes)
        frequencies = min(max(most, 1), MOST_FREQUENCIES)
        images.frame.amplitude, images.frame.total, images.frame.shifts = (
            wp.zeros(count * images.pixels, dtype=wp.float32, device=device)
            for count in (1, 1, frequencies)
        )
        bounces = [one is not None for one in each_with('bounce', effects)]
        widths = [None if one is None else one.width for one in each_with('scatter', effects)]
        self._indirect = self._scattered = None
        self._mixes = 'footprint' in needs_of(effects)
        if any(bounces):
            self._indirect = IndirectLight(bounces, frequencies, images)
        if any(widths):
            self._scattered = ScatteredLight(widths, frequencies, images)
        wp.load_module(__name__, device=device)

    def begin(self) -> None:
        """Register a new frame in all environments."""
        if self._indirect is not None:
            self._indirect.begin()

    def find(self) -> None:
        """Write the light of the environments of the pass."""
        images = self._images
        images.each_pixel(find_light)
        images.each_pixel(clear_shifts)
        if self._mixes and images.lists:
            images.frame.listed.zero_()
            images.each_pixel(list_mixed)
            images.each_listed(mix_listed)
        elif self._mixes:
            images.each_pixel(mix_rows)
        for more in (self._indirect, self._scattered):
            if more is not None:
                more.add()

"""
The effect multipath in a batch: light that was reflected twice; see `effects.interreflection`.

What patches get from each other is kept: it changes only when a patch does.
"""

from collections.abc import Sequence

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import reflectivity_at, TURN
from flexx2_sim_ros.batch.frame import (
    Bounce,
    Frame,
    NO,
    of_frequencies,
    of_pixels,
    OPTIONS,
    Own,
    padded,
    place,
    YES,
)
from flexx2_sim_ros.batch.history import places_of
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.batch.kernels import slopes
from flexx2_sim_ros.effects import interreflection
from flexx2_sim_ros.effects.interreflection import PATCH_FIELDS, RECEIVER, SENDER
from flexx2_sim_ros.formulas import fastmath
from flexx2_sim_ros.formulas import surfaces as surface_formulas
import warp as wp

wp.set_module_options(OPTIONS)

_FIELDS = wp.constant(PATCH_FIELDS)
_RECEIVER = wp.constant(RECEIVER)

_patch = compiled(interreflection.patch)
_light_from = compiled(interreflection.light_from)
_receiver_before = compiled(interreflection.receiver_before)
_receiver_weights = compiled(interreflection.receiver_weights)
_with_bounce = compiled(interreflection.with_bounce)
_ray_length = compiled(surface_formulas.ray_length)
_direction = compiled(fastmath.direction)


@wp.kernel
def begin(f: Frame):
    """Register a new frame; after a reset everything is computed again."""
    n = wp.tid()
    kept = f.bounce.places[n]
    if kept >= 0:
        f.bounce.changed[kept] = f.is_first[n]


@wp.func
def keep(values: wp.array(dtype=wp.float32), i: wp.int32, value: wp.float32) -> wp.int32:
    """Write a value, and return 1 if it is new."""
    new = wp.int32(0)
    if at(values, i) != value:
        put(values, i, value)
        new = wp.int32(1)
    return new


@wp.kernel
def find_patches(f: Frame, side: wp.int32, patches: wp.array(dtype=wp.float32)):
    """Describe the patches of one size."""
    n, row, column = wp.tid()
    lens = f.lens
    kept = f.bounce.places[f.first + n]
    if kept < 0:
        return
    columns = (lens.width + side - 1) / side
    count = (lens.height + side - 1) / side * columns
    y = wp.min(row * side + side / 2, lens.height - 1)
    x = wp.min(column * side + side / 2, lens.width - 1)
    i = padded(lens, n, y, x)
    here = at(f.surfaces.p, i)
    k = kept * _FIELDS * count + row * columns + column
    if here <= 0.0:
        # Radiosity and depth 0: the other fields are not read.
        if keep(patches, k + 7 * count, 0.0) + keep(patches, k + 8 * count, 0.0) > 0:
            f.bounce.changed[kept] = YES
        return
    d = slopes(f.surfaces, i)
    tall = wp.min(side, lens.height - row * side)
    wide = wp.min(side, lens.width - column * side)
    px, py, pz, nx, ny, nz, reach, radiosity, inverse, area, irradiance = _patch(
        here,
        d[0],
        d[1],
        wp.float32(x) - lens.cx,
        wp.float32(y) - lens.cy,
        lens.fx,
        lens.fy,
        wp.float32(tall * wide),
        reflectivity_at(f.surfaces, n, y, x),
    )
    new = keep(patches, k, px)
    new += keep(patches, k + count, py)
    new += keep(patches, k + 2 * count, pz)
    new += keep(patches, k + 3 * count, nx)
    new += keep(patches, k + 4 * count, ny)
    new += keep(patches, k + 5 * count, nz)
    new += keep(patches, k + 6 * count, reach)
    new += keep(patches, k + 7 * count, radiosity)
    new += keep(patches, k + 8 * count, inverse)
    new += keep(patches, k + 9 * count, area)
    new += keep(patches, k + 10 * count, irradiance)
    if new > 0:
        f.bounce.changed[kept] = YES


@wp.func
def light_between(bounce: Bounce, r: wp.int32, s: wp.int32) -> tuple[wp.float32, wp.float32]:
    """Return the light from sender ``s`` at receiver ``r``, and how much longer its path is."""
    count = bounce.receiver_count
    senders = bounce.sender_count
    light, path = _light_from(
        at(bounce.senders, s) - at(bounce.receivers, r),
        at(bounce.senders, s + senders) - at(bounce.receivers, r + count),
        at(bounce.senders, s + 2 * senders) - at(bounce.receivers, r + 2 * count),
        at(bounce.senders, s + 3 * senders),
        at(bounce.senders, s + 4 * senders),
        at(bounce.senders, s + 5 * senders),
        at(bounce.senders, s + 7 * senders),
        at(bounce.senders, s + 9 * senders),
        at(bounce.senders, s + 6 * senders),
        at(bounce.receivers, r + 3 * count),
        at(bounce.receivers, r + 4 * count),
        at(bounce.receivers, r + 5 * count),
        at(bounce.receivers, r + 6 * count),
    )
    return light, path


@wp.func
def is_dark(f: Frame, n: wp.int32) -> wp.bool:
    """Say whether an environment has no patches, or still the light that it had."""
    kept = f.bounce.places[f.first + n]
    return kept < 0 or f.bounce.changed[wp.max(kept, 0)] == NO


@wp.kernel
def gather(f: Frame):
    """Write what a receiver gets from all senders at a frequency, over the direct light."""
    n, receiver, k = wp.tid()
    bounce = f.bounce
    light = f.lights[f.first + n]
    if k >= light.frequencies or is_dark(f, n):
        return
    kept = bounce.places[f.first + n]
    count = bounce.receiver_count
    r = kept * _FIELDS * count + receiver
    out = (kept * bounce.frequencies + k) * 2 * count + receiver
    real = wp.float32(0.0)
    imaginary = wp.float32(0.0)
    if at(bounce.receivers, r + 8 * count) > 0.0:
        # The longer path is passed once, the direct one there and back.
        turns = 0.5 * light.turns[k]
        s = kept * _FIELDS * bounce.sender_count
        i = wp.int32(0)
        while i < bounce.sender_count:
            shine, path = light_between(bounce, r, s + i)
            cosine, sine = _direction(turns * path)
            real += shine * cosine
            imaginary += shine * sine
            i += 1
        irradiance = at(bounce.receivers, r + 10 * count)
        real = real / irradiance
        imaginary = imaginary / irradiance
    put(bounce.indirect, out, real)
    put(bounce.indirect, out + count, imaginary)


@wp.kernel
def gather_all(f: Frame):
    """Do what `gather` does for all frequencies, which share the geometry. For CUDA."""
    n, receiver = wp.tid()
    if is_dark(f, n):
        return
    bounce = f.bounce
    light = f.lights[f.first + n]
    kept = bounce.places[f.first + n]
    count = bounce.receiver_count
    r = kept * _FIELDS * count + receiver
    real = wp.vec3f()
    imaginary = wp.vec3f()
    if at(bounce.receivers, r + 8 * count) > 0.0:
        turns = 0.5 * light.turns
        s = kept * _FIELDS * bounce.sender_count
        i = wp.int32(0)
        while i < bounce.sender_count:
            shine, path = light_between(bounce, r, s + i)
            for k in range(3):
                if k < light.frequencies:
                    cosine, sine = _direction(turns[k] * path)
                    real[k] += shine * cosine
                    imaginary[k] += shine * sine
            i += 1
        irradiance = at(bounce.receivers, r + 10 * count)
        real = real / irradiance
        imaginary = imaginary / irradiance
    for k in range(3):
        if k < light.frequencies:
            out = (kept * bounce.frequencies + k) * 2 * count + receiver
            put(bounce.indirect, out, real[k])
            put(bounce.indirect, out + count, imaginary[k])


@wp.kernel
def widen(f: Frame):
    """Write for each pixel of a row of receivers what is to its left and to its right."""
    n, row, c = wp.tid()
    bounce = f.bounce
    kept = bounce.places[f.first + n]
    if kept < 0:
        return
    width = f.lens.width
    count = bounce.receiver_count
    columns = (width + _RECEIVER - 1) / _RECEIVER
    depths = (kept * _FIELDS + 8) * count + row * columns
    indirect = kept * bounce.frequencies * 2 * count + row * columns
    size = width * count / columns
    out = n * bounce.fields * size + row * width
    values = 2 * f.lights[f.first + n].frequencies
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, width)
    stride = stride_of(width)
    while x < end:
        left, _share = _receiver_before(x, columns)
        right = wp.min(left + 1, columns - 1)
        put(bounce.wide, out + x, at(bounce.receivers, depths + left))
        put(bounce.wide, out + size + x, at(bounce.receivers, depths + right))
        k = wp.int32(0)
        while k < values:
            field = out + (2 + 2 * k) * size + x
            put(bounce.wide, field, at(bounce.indirect, indirect + k * count + left))
            put(bounce.wide, field + size, at(bounce.indirect, indirect + k * count + right))
            k += 1
        x += stride


@wp.func
def weights_around(
    wide: wp.array(dtype=wp.float32),
    a: wp.int32,
    b: wp.int32,
    size: wp.int32,
    here: wp.float32,
    right: wp.float32,
    down: wp.float32,
    others: wp.vec2f,
) -> wp.vec4f:
    """Return the weights, sum 1 or 0, of the four receivers around a pixel."""
    w0, w1, w2, w3 = _receiver_weights(
        here,
        right,
        down,
        at(wide, a),
        at(wide, a + size) * others[0],
        at(wide, b) * others[1],
        at(wide, b + size) * others[0] * others[1],
    )
    return wp.vec4f(w0, w1, w2, w3)


@wp.func
def mixed_around(
    wide: wp.array(dtype=wp.float32), a: wp.int32, b: wp.int32, size: wp.int32, w: wp.vec4f
) -> wp.float32:
    """Return a value between the four receivers around a pixel."""
    above = w[0] * at(wide, a) + w[1] * at(wide, a + size)
    return above + w[2] * at(wide, b) + w[3] * at(wide, b + size)


@wp.func
def _bounces(f: Frame, own: Own) -> wp.bool:
    return f.bounce.places[own.env] >= 0


@of_frequencies(when=_bounces, launch_bounds=(256, 5))  # docs/batch.md#on-a-gpu
def add_bounce(f: Frame, own: Own, k: wp.int32, n: wp.int32, y: wp.int32, x: wp.int32):
    """Add to each pixel the indirect light of the receivers around it: bilinear, of like depth."""
    lens = f.lens
    wide = f.bounce.wide
    columns = (lens.width + _RECEIVER - 1) / _RECEIVER
    rows = f.bounce.receiver_count / columns
    size = rows * lens.width
    row, down = _receiver_before(y, rows)
    left, right = _receiver_before(x, columns)
    images = n * f.bounce.fields * size + x
    a = images + row * lens.width
    b = images + wp.min(row + 1, rows - 1) * lens.width
    # 0 where the image has one column or one row of receivers.
    others = wp.vec2f(wp.where(columns > 1, 1.0, 0.0), wp.where(rows > 1, 1.0, 0.0))
    w = weights_around(
        wide, a, b, size, at(f.surfaces.p, padded(lens, n, y, x)), right, down, others
    )
    real = (2 + 4 * k) * size
    more, gain = _with_bounce(
        own.effects.multipath_gain,
        mixed_around(wide, a + real, b + real, size, w),
        mixed_around(wide, a + real + 2 * size, b + real + 2 * size, size, w),
        TURN * own.turns,
        _ray_length((wp.float32(x) - lens.cx) / lens.fx, (wp.float32(y) - lens.cy) / lens.fy),
    )
    pixel = place(lens, n, y, x)
    put(f.shifts, k * f.pitch + pixel, at(f.shifts, k * f.pitch + pixel) + more)
    before = wp.where(k == 0, 0.0, at(f.total, pixel))
    put(f.total, pixel, before + own.weight * gain)


@of_pixels(when=_bounces)
def brighten(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Multiply the amplitude by what the indirect light adds."""
    pixel = place(f.lens, n, y, x)
    put(f.amplitude, pixel, at(f.amplitude, pixel) * at(f.total, pixel))


class IndirectLight:
    """
    What the patches of the environments' images send to each other.

    `chosen` says which environments have the effect, `frequencies` is the most of a mode.
    """

    def __init__(self, chosen: Sequence[bool], frequencies: int, images: Images) -> None:
        """Allocate what is kept of each chosen environment."""
        self._images, device = images, images.device
        envs = sum(chosen)

        def zeros(size: int) -> wp.array:
            return wp.zeros(size, dtype=wp.float32, device=device)

        bounce = Bounce()
        bounce.places = wp.array(places_of(chosen), dtype=wp.int32, device=device)
        bounce.changed = wp.zeros(envs, dtype=wp.uint8, device=device)
        senders, receivers = (
            (-(-images.height // side), -(-images.width // side)) for side in (SENDER, RECEIVER)
        )
        bounce.sender_count = senders[0] * senders[1]
        bounce.receiver_count = receivers[0] * receivers[1]
        bounce.frequencies = frequencies
        bounce.senders = zeros(envs * PATCH_FIELDS * bounce.sender_count)
        bounce.receivers = zeros(envs * PATCH_FIELDS * bounce.receiver_count)
        bounce.indirect = zeros(envs * frequencies * 2 * bounce.receiver_count)
        bounce.fields = 2 + 4 * frequencies
        bounce.wide = zeros(images.most * bounce.fields * receivers[0] * images.width)
        images.frame.bounce = bounce
        self._rows = receivers[0]
        self._patches = (
            (SENDER, senders, bounce.senders),
            (RECEIVER, receivers, bounce.receivers),
        )
        wp.load_module(__name__, device=device)

    def begin(self) -> None:
        """Register a new frame in all environments."""
        frame = self._images.frame
        launch(begin, frame.stamps.size, frame)

    def add(self) -> None:
        """Add the indirect light to the pixels of the pass."""
        images, frame = self._images, self._images.frame
        for side, blocks, patches in self._patches:
            launch(find_patches, (images.count, *blocks), frame, side, patches)
        threads = images.count, frame.bounce.receiver_count
        if images.lists:
            launch(gather_all, threads, frame)
        else:
            launch(gather, (*threads, frame.bounce.frequencies), frame)
        launch(widen, (images.count, self._rows, images.grid(1)[2]), frame)
        images.each_pixel(add_bounce)
        images.each_pixel(brighten)

"""
The effect multipath as Warp kernels; see `effects.interreflection`.

What patches get from each other is kept: it changes only when a patch does.
"""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import reflectivity_at, Surfaces, TURN
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import Lens, OPTIONS, padded, slopes
from flexx2_sim_ros.batch.light_kernels import Phasors
from flexx2_sim_ros.effects import interreflection
from flexx2_sim_ros.effects.interreflection import PATCH_FIELDS, RECEIVER
from flexx2_sim_ros.formulas import phases
from flexx2_sim_ros.formulas import surfaces as surface_formulas
import warp as wp

wp.set_module_options(OPTIONS)

_FIELDS = wp.constant(PATCH_FIELDS)
_RECEIVER = wp.constant(RECEIVER)
_YES = wp.constant(wp.uint8(1))
_NO = wp.constant(wp.uint8(0))

_patch = compiled(interreflection.patch)
_light_from = compiled(interreflection.light_from)
_receiver_before = compiled(interreflection.receiver_before)
_receiver_weights = compiled(interreflection.receiver_weights)
_with_bounce = compiled(interreflection.with_bounce)
_ray_length = compiled(surface_formulas.ray_length)
_direction = compiled(phases.direction)


@wp.struct
class Bounce:
    """What is kept of environments with indirect light: arrays of images, one for each."""

    places: wp.array(dtype=wp.int32)  # of each environment in the arrays below; -1 for none
    changed: wp.array(dtype=wp.uint8)  # 1: a patch is not what it was in the frame before
    senders: wp.array(dtype=wp.float32)  # `patch`, one field of all patches after the other
    receivers: wp.array(dtype=wp.float32)
    indirect: wp.array(dtype=wp.float32)  # by frequency, of receivers: real, then imaginary
    wide: wp.array(dtype=wp.float32)  # of the pass, see `widen`: depth, then as `indirect`
    fields: wp.int32  # in `wide`, left and right each
    sender_count: wp.int32
    receiver_count: wp.int32
    frequencies: wp.int32  # that there is room for


@wp.kernel
def begin(is_first: wp.array(dtype=wp.uint8), bounce: Bounce):
    """Register a new frame; after a reset everything is computed again."""
    n = wp.tid()
    place = bounce.places[n]
    if place >= 0:
        bounce.changed[place] = is_first[n]


@wp.func
def keep(values: wp.array(dtype=wp.float32), i: wp.int32, value: wp.float32) -> wp.int32:
    """Write a value, and return 1 if it is new."""
    new = wp.int32(0)
    if at(values, i) != value:
        put(values, i, value)
        new = wp.int32(1)
    return new


@wp.kernel
def find_patches(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    side: wp.int32,
    bounce: Bounce,
    patches: wp.array(dtype=wp.float32),
):
    """Describe the patches of one size."""
    n, row, column = wp.tid()
    place = bounce.places[first + n]
    if place < 0:
        return
    columns = (lens.width + side - 1) / side
    count = (lens.height + side - 1) / side * columns
    y = wp.min(row * side + side / 2, lens.height - 1)
    x = wp.min(column * side + side / 2, lens.width - 1)
    i = padded(lens, n, y, x)
    here = at(surfaces.p, i)
    k = place * _FIELDS * count + row * columns + column
    if here <= 0.0:
        # Radiosity and depth 0: the other fields are not read.
        if keep(patches, k + 7 * count, 0.0) + keep(patches, k + 8 * count, 0.0) > 0:
            bounce.changed[place] = _YES
        return
    d = slopes(surfaces.p, surfaces.jumps, lens, i)
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
        reflectivity_at(surfaces, lens, n, y, x),
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
        bounce.changed[place] = _YES


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


@wp.kernel
def gather(first: wp.int32, lights: wp.array(dtype=Light), bounce: Bounce):
    """Write what a receiver gets from all senders at a frequency, over the direct light."""
    n, receiver, f = wp.tid()
    place = bounce.places[first + n]
    if place < 0 or f >= lights[first + n].frequencies:
        return
    if bounce.changed[place] == _NO:
        return
    count = bounce.receiver_count
    r = place * _FIELDS * count + receiver
    out = (place * bounce.frequencies + f) * 2 * count + receiver
    real = wp.float32(0.0)
    imaginary = wp.float32(0.0)
    if at(bounce.receivers, r + 8 * count) > 0.0:
        # The longer path is passed once, the direct one there and back.
        turns = 0.5 * lights[first + n].turns[f]
        s = place * _FIELDS * bounce.sender_count
        i = wp.int32(0)
        while i < bounce.sender_count:
            light, path = light_between(bounce, r, s + i)
            cosine, sine = _direction(turns * path)
            real += light * cosine
            imaginary += light * sine
            i += 1
        irradiance = at(bounce.receivers, r + 10 * count)
        real = real / irradiance
        imaginary = imaginary / irradiance
    put(bounce.indirect, out, real)
    put(bounce.indirect, out + count, imaginary)


@wp.kernel
def gather_all(first: wp.int32, lights: wp.array(dtype=Light), bounce: Bounce):
    """Do what `gather` does for all frequencies, which share the geometry. For CUDA."""
    n, receiver = wp.tid()
    place = bounce.places[first + n]
    if place < 0 or bounce.changed[place] == _NO:
        return
    count = bounce.receiver_count
    r = place * _FIELDS * count + receiver
    real = wp.vec3f()
    imaginary = wp.vec3f()
    frequencies = lights[first + n].frequencies
    if at(bounce.receivers, r + 8 * count) > 0.0:
        turns = 0.5 * lights[first + n].turns
        s = place * _FIELDS * bounce.sender_count
        i = wp.int32(0)
        while i < bounce.sender_count:
            light, path = light_between(bounce, r, s + i)
            for f in range(3):
                if f < frequencies:
                    cosine, sine = _direction(turns[f] * path)
                    real[f] += light * cosine
                    imaginary[f] += light * sine
            i += 1
        irradiance = at(bounce.receivers, r + 10 * count)
        real = real / irradiance
        imaginary = imaginary / irradiance
    for f in range(3):
        if f < frequencies:
            out = (place * bounce.frequencies + f) * 2 * count + receiver
            put(bounce.indirect, out, real[f])
            put(bounce.indirect, out + count, imaginary[f])


@wp.kernel
def widen(
    lens: Lens, first: wp.int32, chunk: wp.int32, lights: wp.array(dtype=Light), bounce: Bounce
):
    """Write for each pixel of a row of receivers what is to its left and to its right."""
    n, row, c = wp.tid()
    place = bounce.places[first + n]
    if place < 0:
        return
    count = bounce.receiver_count
    columns = (lens.width + _RECEIVER - 1) / _RECEIVER
    depths = (place * _FIELDS + 8) * count + row * columns
    indirect = place * bounce.frequencies * 2 * count + row * columns
    size = lens.width * count / columns
    out = n * bounce.fields * size + row * lens.width
    values = 2 * lights[first + n].frequencies
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
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


@wp.kernel(launch_bounds=(256, 5))  # docs/batch.md#on-a-gpu
def add_bounce(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    bounce: Bounce,
    phasors: Phasors,
):
    """Add to each pixel the indirect light of the receivers around it: bilinear, of like depth."""
    n, y, c = wp.tid()
    if bounce.places[first + n] < 0:
        return
    light = lights[first + n]
    factor = effects[first + n].multipath_gain
    columns = (lens.width + _RECEIVER - 1) / _RECEIVER
    rows = bounce.receiver_count / columns
    row, down = _receiver_before(y, rows)
    size = rows * lens.width
    above = n * bounce.fields * size + row * lens.width
    below = n * bounce.fields * size + wp.min(row + 1, rows - 1) * lens.width
    # 0 where the image has one column or one row of receivers.
    others = wp.vec2f(wp.where(columns > 1, 1.0, 0.0), wp.where(rows > 1, 1.0, 0.0))
    ry = (wp.float32(y) - lens.cy) / lens.fy
    start = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    pixel = (n * lens.height + y) * lens.width
    i = padded(lens, n, y, 0)
    f = wp.int32(0)
    while f < light.frequencies:
        wave_number = TURN * light.turns[f]
        weight = light.weights[f]
        shift = f * phasors.pitch + pixel
        real = (2 + 4 * f) * size
        x = wp.int32(start)
        while x < end:
            here = at(surfaces.p, i + x)
            _left, right = _receiver_before(x, columns)
            a = above + x
            b = below + x
            w = weights_around(bounce.wide, a, b, size, here, right, down, others)
            more, gain = _with_bounce(
                factor,
                mixed_around(bounce.wide, a + real, b + real, size, w),
                mixed_around(bounce.wide, a + real + 2 * size, b + real + 2 * size, size, w),
                wave_number,
                _ray_length((wp.float32(x) - lens.cx) / lens.fx, ry),
            )
            put(phasors.shifts, shift + x, at(phasors.shifts, shift + x) + more)
            before = wp.where(f == 0, 0.0, at(phasors.total, pixel + x))
            put(phasors.total, pixel + x, before + weight * gain)
            x += stride
        f += 1
    x = wp.int32(start)
    while x < end:
        brighter = at(phasors.total, pixel + x)
        put(phasors.amplitude, pixel + x, at(phasors.amplitude, pixel + x) * brighter)
        x += stride

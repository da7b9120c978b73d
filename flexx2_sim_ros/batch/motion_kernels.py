"""The effect motion_artefact as Warp kernels; see `effects.motion_artefact`."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import agreed, draw, reflectivity_at, Surfaces, TURN
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import distance, Lens, OPTIONS, padded
from flexx2_sim_ros.batch.light_kernels import Phasors
from flexx2_sim_ros.batch.memory_kernels import Kept
from flexx2_sim_ros.effects import motion_artefact, passing
import warp as wp

wp.set_module_options(OPTIONS)

_DARKEST = wp.constant(wp.float32(motion_artefact.DARKEST))
_STREAM = wp.constant(wp.uint32(motion_artefact.MotionArtefact.stream))
_TAPS = wp.constant(motion_artefact.TAPS)
_NAN = wp.constant(wp.float32(float('nan')))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_edge_reach = compiled(passing.edge_reach)
_is_edge = compiled(passing.is_edge)
_own_change = compiled(passing.own_change)
_find_passing = compiled(passing.find_passing)
_tap_moment = compiled(motion_artefact.tap_moment)
_motion_shift = compiled(motion_artefact.motion_shift)


@wp.struct
class Motion:
    """The frame before of every environment, and how each pixel of a pass moves."""

    depth: wp.array(dtype=wp.float32)  # of every environment: metres; NaN without a return
    reflectivity: wp.array(dtype=wp.float32)  # of every environment
    late: wp.array(dtype=wp.float32)  # of the pass: depth and
    late_reflectivity: wp.array(dtype=wp.float32)  # reflectivity now,
    across: wp.array(dtype=wp.float32)  # 1 at an edge to the pixel on the left,
    down: wp.array(dtype=wp.float32)  # or above
    start: wp.array(dtype=wp.float32)  # depth before less depth now
    gain: wp.array(dtype=wp.float32)  # light before over that now
    other: wp.array(dtype=wp.float32)  # depth across the edge that passes, metres,
    light: wp.array(dtype=wp.float32)  # light there over that here,
    when: wp.array(dtype=wp.float32)  # and when it passes; 1: never


@wp.func
def seconds_between(kept: Kept, effects: Effects, n: wp.int32) -> wp.float32:
    """Return the time since the frame before; 0 without the effect and in the first frame."""
    seconds = wp.float32(kept.last[n] - kept.before[n]) * _PER_NANOSECOND
    idle = effects.motion_artefact_strength <= 0.0 or kept.is_first[n] == wp.uint8(1)
    return wp.where(idle, 0.0, seconds)


@wp.func
def moment(tap: wp.float32, e: Effects, light: Light, seconds: wp.float32) -> wp.float32:
    """Return when a raw frame is taken, see `tap_moment`."""
    acquisition = e.motion_artefact_stretch * light.acquisition / seconds
    taps = wp.float32(_TAPS * light.frequencies)
    return _tap_moment(tap, taps, acquisition, e.motion_artefact_stamp_at)


@wp.kernel
def look(surfaces: Surfaces, lens: Lens, first: wp.int32, chunk: wp.int32, motion: Motion):
    """Write what each pixel sees now."""
    n, y, c = wp.tid()
    row = (n * lens.height + y) * lens.width
    i = padded(lens, n, y, 0)
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        put(motion.late, row + x, distance(at(surfaces.p, i + x), _NAN))
        rho = wp.max(reflectivity_at(surfaces, lens, n, y, x), _DARKEST)
        put(motion.late_reflectivity, row + x, rho)
        x += stride


@wp.func
def edge_between(motion: Motion, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return 1 if two neighbours show different surfaces or colours, otherwise 0."""
    late, rho = motion.late, motion.late_reflectivity
    return wp.where(_is_edge(at(late, i), at(late, j), at(rho, i), at(rho, j)), 1.0, 0.0)


@wp.kernel
def mark_edges(lens: Lens, first: wp.int32, chunk: wp.int32, motion: Motion):
    """Write where edges are now."""
    n, y, c = wp.tid()
    row = (n * lens.height + y) * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        i = row + x
        across = wp.float32(0.0)
        down = wp.float32(0.0)
        if x > 0:
            across = edge_between(motion, i - 1, i)
        if y > 0:
            down = edge_between(motion, i - lens.width, i)
        put(motion.across, i, across)
        put(motion.down, i, down)
        x += stride


@wp.func
def edge_distance(
    edges: wp.array(dtype=wp.float32), i: wp.int32, step: wp.int32, far: wp.int32
) -> wp.int32:
    """
    Return how many steps the first pixel of another surface or colour is away; 0 if too far.

    An edge is 1 between a pixel and the one before it in its row, or in its column if steps go
    along that.
    """
    found = wp.int32(0)
    j = i + wp.max(step, 0)
    k = wp.int32(1)
    while k <= far:
        if at(edges, j) > 0.0:
            found = wp.int32(k)
            k = wp.int32(far)
        j += step
        k += 1
    return found


@wp.kernel(launch_bounds=(256, 4))  # docs/batch.md#on-a-gpu
def find_motion(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    keys: wp.array(dtype=wp.vec2ui),
    kept: Kept,
    motion: Motion,
):
    """Write how each pixel moves between two frames, and which edge passes it."""
    n, y, c = wp.tid()
    e = effects[first + n]
    light = lights[first + n]
    seconds = seconds_between(kept, e, first + n)
    if seconds <= 0.0:
        return
    stamp = kept.last[first + n]
    row = (n * lens.height + y) * lens.width
    before = ((first + n) * lens.height + y) * lens.width
    earliest = 1.0 - moment(0.0, e, light, seconds)
    latest = moment(wp.float32(_TAPS * light.frequencies - 1), e, light, seconds) - 1.0
    reach = _edge_reach(earliest, latest)
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        i = row + x
        right = edge_distance(motion.across, i, 1, wp.min(reach, lens.width - 1 - x))
        left = edge_distance(motion.across, i, -1, wp.min(reach, x))
        down = edge_distance(motion.down, i, lens.width, wp.min(reach, lens.height - 1 - y))
        up = edge_distance(motion.down, i, -lens.width, wp.min(reach, y))
        start, gain = _own_change(
            at(motion.depth, before + x),
            at(motion.late, row + x),
            at(motion.reflectivity, before + x),
            at(motion.late_reflectivity, row + x),
            seconds,
        )
        other, light_there, when = _find_passing(
            motion.depth,
            motion.late,
            motion.reflectivity,
            motion.late_reflectivity,
            right,
            left,
            down,
            up,
            before + x,
            row + x,
            y,
            x,
            lens.height,
            lens.width,
            earliest,
            latest,
            draw(y * lens.width + x, _STREAM, stamp, keys[first + n]),
        )
        put(motion.start, row + x, start)
        put(motion.gain, row + x, gain)
        put(motion.other, row + x, other)
        put(motion.light, row + x, light_there)
        put(motion.when, row + x, when)
        x += stride


@wp.kernel
def keep(lens: Lens, first: wp.int32, chunk: wp.int32, kept: Kept, motion: Motion):
    """Keep what each pixel sees now."""
    n, y, c = wp.tid()
    if kept.is_due[first + n] == wp.uint8(0):
        return
    row = (n * lens.height + y) * lens.width
    before = ((first + n) * lens.height + y) * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        put(motion.depth, before + x, at(motion.late, row + x))
        put(motion.reflectivity, before + x, at(motion.late_reflectivity, row + x))
        x += stride


@wp.kernel
def shift_phases(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    kept: Kept,
    motion: Motion,
    phasors: Phasors,
):
    """Add to each frequency's shift what the motion between its raw frames adds."""
    n, y, c = wp.tid()
    e = effects[first + n]
    light = lights[first + n]
    seconds = seconds_between(kept, e, first + n)
    if seconds <= 0.0:
        return
    row = (n * lens.height + y) * lens.width
    begin = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    f = wp.int32(0)
    while f < light.frequencies:
        tap = wp.float32(_TAPS * f)
        m0 = moment(tap, e, light, seconds)
        m1 = moment(tap + 1.0, e, light, seconds)
        m2 = moment(tap + 2.0, e, light, seconds)
        m3 = moment(tap + 3.0, e, light, seconds)
        k = TURN * light.turns[f]
        shifts = f * phasors.pitch + row
        x = wp.int32(begin)
        while x < end:
            z = at(motion.late, row + x)
            add = at(phasors.shifts, shifts + x)
            more = _motion_shift(
                z,
                at(motion.start, row + x),
                at(motion.gain, row + x),
                at(motion.other, row + x),
                at(motion.light, row + x),
                at(motion.when, row + x),
                m0,
                m1,
                m2,
                m3,
                k,
                add,
            )
            put(phasors.shifts, shifts + x, wp.where(z > 0.0, add + more, add))
            x += stride
        f += 1


@wp.kernel
def unwrap(
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    lights: wp.array(dtype=Light),
    kept: Kept,
    motion: Motion,
    phasors: Phasors,
):
    """Let frequencies that saw different surfaces agree on a distance."""
    n, y, c = wp.tid()
    light = lights[first + n]
    if seconds_between(kept, effects[first + n], first + n) <= 0.0 or light.frequencies < 2:
        return
    row = (n * lens.height + y) * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    while x < end:
        if at(motion.when, row + x) != 1.0:
            shifts = wp.vec3f()
            for f in range(3):
                if f < light.frequencies:
                    shifts[f] = at(phasors.shifts, f * phasors.pitch + row + x)
            shifts = agreed(light, shifts, at(motion.late, row + x))
            for f in range(3):
                if f < light.frequencies:
                    put(phasors.shifts, f * phasors.pitch + row + x, shifts[f])
        x += stride

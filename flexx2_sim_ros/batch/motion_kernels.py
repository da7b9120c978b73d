"""The effect motion_artefact as Warp kernels; see `effects.motion_artefact`."""

from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import draw, reflectivity_at, Surfaces, TURN
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.batch.kernels import distance, Lens, OPTIONS, padded
from flexx2_sim_ros.batch.light_kernels import Phasors
from flexx2_sim_ros.batch.memory_kernels import Kept
from flexx2_sim_ros.effects import between, motion_artefact
import warp as wp

wp.set_module_options(OPTIONS)

_DARKEST = wp.constant(wp.float32(motion_artefact.DARKEST))
_STREAM = wp.constant(wp.uint32(motion_artefact.MotionArtefact.stream))
_TAPS = wp.constant(motion_artefact.TAPS)
_NAN = wp.constant(wp.float32(float('nan')))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_alike = compiled(between.alike)
_tap_moment = compiled(motion_artefact.tap_moment)
_motion_shift = compiled(motion_artefact.motion_shift)


@wp.struct
class Motion:
    """The frame before of every environment, and how each pixel of a pass moves."""

    depth: wp.array(dtype=wp.float32)  # of every environment: metres; NaN without a return
    reflectivity: wp.array(dtype=wp.float32)  # of every environment
    start: wp.array(dtype=wp.float32)  # of the pass: depth before less depth now; NaN: still
    brighter: wp.array(dtype=wp.float32)  # of the pass: reflectivity before over that now
    change: wp.array(dtype=wp.float32)  # of the pass: when another surface comes into view


@wp.func
def seconds_between(kept: Kept, effects: Effects, n: wp.int32) -> wp.float32:
    """Return the time since the frame before; 0 without the effect and in the first frame."""
    seconds = wp.float32(kept.last[n] - kept.before[n]) * _PER_NANOSECOND
    idle = effects.motion_artefact_strength <= 0.0 or kept.is_first[n] == wp.uint8(1)
    return wp.where(idle, 0.0, seconds)


@wp.kernel
def find_motion(
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    effects: wp.array(dtype=Effects),
    keys: wp.array(dtype=wp.vec2ui),
    kept: Kept,
    motion: Motion,
):
    """Write how each pixel moves between two frames, and keep what it sees now."""
    n, y, c = wp.tid()
    if kept.is_due[first + n] == wp.uint8(0):
        return
    seconds = seconds_between(kept, effects[first + n], first + n)
    stamp = kept.last[first + n]
    row = (n * lens.height + y) * lens.width
    before = ((first + n) * lens.height + y) * lens.width
    i = padded(lens, n, y, 0)
    x = c * chunk
    end = wp.min(x + chunk, lens.width)
    while x < end:
        z = distance(at(surfaces.p, i + x), _NAN)
        rho = wp.max(reflectivity_at(surfaces, lens, n, y, x), _DARKEST)
        if seconds > 0.0:
            start = at(motion.depth, before + x) - z
            brighter = at(motion.reflectivity, before + x) / rho
            passes = brighter != 1.0 or (start != 0.0 and not _alike(start, z, seconds))
            if start == start and passes:
                put(
                    motion.change,
                    row + x,
                    draw(y * lens.width + x, _STREAM, stamp, keys[first + n]),
                )
            moves = start != 0.0 or passes
            put(motion.start, row + x, wp.where(moves, start, _NAN))
            put(motion.brighter, row + x, brighter)
        put(motion.depth, before + x, z)
        put(motion.reflectivity, before + x, rho)
        x += 1


@wp.kernel
def shift_phases(
    surfaces: Surfaces,
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
    acquisition = e.motion_artefact_stretch * light.acquisition / seconds
    taps = wp.float32(_TAPS * light.frequencies)
    row = (n * lens.height + y) * lens.width
    i = padded(lens, n, y, 0)
    begin = c * chunk
    end = wp.min(begin + chunk, lens.width)
    f = wp.int32(0)
    while f < light.frequencies:
        tap = wp.float32(_TAPS * f)
        m0 = _tap_moment(tap, taps, acquisition, e.motion_artefact_stamp_at)
        m1 = _tap_moment(tap + 1.0, taps, acquisition, e.motion_artefact_stamp_at)
        m2 = _tap_moment(tap + 2.0, taps, acquisition, e.motion_artefact_stamp_at)
        m3 = _tap_moment(tap + 3.0, taps, acquisition, e.motion_artefact_stamp_at)
        k = TURN * light.turns[f]
        shifts = f * phasors.pitch + row
        x = wp.int32(begin)
        while x < end:
            z = distance(at(surfaces.p, i + x), 1.0)
            start = at(motion.start, row + x)
            brighter = at(motion.brighter, row + x)
            change = at(motion.change, row + x)
            add = at(phasors.shifts, shifts + x)
            more = _motion_shift(z, start, brighter, change, seconds, m0, m1, m2, m3, k, add)
            put(phasors.shifts, shifts + x, wp.where(start == start, add + more, add))
            x += 1
        f += 1

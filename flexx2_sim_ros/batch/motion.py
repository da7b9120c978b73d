"""The effects motion_artefact and motion_dropout in a batch; see `effects.moving`."""

from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import agreed, draw, reflectivity_at, TURN
from flexx2_sim_ros.batch.frame import (
    Frame,
    Motion,
    of_frequencies,
    of_pixels,
    OPTIONS,
    Own,
    padded,
    place,
)
from flexx2_sim_ros.batch.images import Images
from flexx2_sim_ros.batch.kernels import distance
from flexx2_sim_ros.effects import motion_artefact, motion_dropout, moving, passing
import warp as wp

wp.set_module_options(OPTIONS)

_DARKEST = wp.constant(wp.float32(moving.DARKEST))
_STREAM = wp.constant(wp.uint32(motion_artefact.MotionArtefact.stream))
_DROPOUT_STREAM = wp.constant(wp.uint32(motion_dropout.MotionDropout.stream))
_TAPS = wp.constant(moving.TAPS)
_NAN = wp.constant(wp.float32(float('nan')))
_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_edge_reach = compiled(passing.edge_reach)
_is_edge = compiled(passing.is_edge)
_own_change = compiled(passing.own_change)
_find_passing = compiled(passing.find_passing)
_tap_moment = compiled(moving.tap_moment)
_motion_shift = compiled(motion_artefact.motion_shift)


@wp.func
def seconds_between(own: Own) -> wp.float32:
    """Return the time since the frame before; 0 in the first frame."""
    return wp.where(own.is_first, 0.0, wp.float32(own.interval) * _PER_NANOSECOND)


@wp.func
def _has_moved(f: Frame, own: Own) -> wp.bool:
    return own.effects.motion_artefact_strength > 0.0 and seconds_between(own) > 0.0


@wp.func
def _drops(f: Frame, own: Own) -> wp.bool:
    return own.effects.motion_dropout_strength > 0.0 and seconds_between(own) > 0.0


@wp.func
def moment(tap: wp.float32, own: Own, stretch: wp.float32, stamp_at: wp.float32) -> wp.float32:
    """Return when a raw frame is taken, see `tap_moment`."""
    taps = wp.float32(_TAPS * own.light.frequencies)
    acquisition = stretch * own.light.acquisition / seconds_between(own)
    return _tap_moment(tap, taps, acquisition, stamp_at)


@of_pixels()
def look(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write what each pixel sees now."""
    i = place(f.lens, n, y, x)
    put(f.motion.late, i, distance(at(f.surfaces.p, padded(f.lens, n, y, x)), _NAN))
    put(f.motion.late_reflectivity, i, wp.max(reflectivity_at(f.surfaces, n, y, x), _DARKEST))


@wp.func
def edge_between(motion: Motion, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return 1 if two neighbours show different surfaces or colours, otherwise 0."""
    late, rho = motion.late, motion.late_reflectivity
    return wp.where(_is_edge(at(late, i), at(late, j), at(rho, i), at(rho, j)), 1.0, 0.0)


@of_pixels()
def mark_edges(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write where edges are now."""
    i = place(f.lens, n, y, x)
    across = wp.float32(0.0)
    down = wp.float32(0.0)
    if x > 0:
        across = edge_between(f.motion, i - 1, i)
    if y > 0:
        down = edge_between(f.motion, i - f.lens.width, i)
    put(f.motion.across, i, across)
    put(f.motion.down, i, down)


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


@wp.func
def passing_edge(
    f: Frame,
    own: Own,
    n: wp.int32,
    y: wp.int32,
    x: wp.int32,
    stretch: wp.float32,
    stamp_at: wp.float32,
    stream: wp.uint32,
) -> wp.vec3f:
    """Return depth, light and time of what is beyond the edge that passes a pixel."""
    motion = f.motion
    height, width = f.lens.height, f.lens.width
    i = place(f.lens, n, y, x)
    before = place(f.lens, own.env, y, x)
    last = wp.float32(_TAPS * own.light.frequencies - 1)
    earliest = 1.0 - moment(0.0, own, stretch, stamp_at)
    latest = moment(last, own, stretch, stamp_at) - 1.0
    reach = _edge_reach(earliest, latest)
    other, light_there, when = _find_passing(
        motion.depth,
        motion.late,
        motion.reflectivity,
        motion.late_reflectivity,
        edge_distance(motion.across, i, 1, wp.min(reach, width - 1 - x)),
        edge_distance(motion.across, i, -1, wp.min(reach, x)),
        edge_distance(motion.down, i, width, wp.min(reach, height - 1 - y)),
        edge_distance(motion.down, i, -width, wp.min(reach, y)),
        before,
        i,
        y,
        x,
        height,
        width,
        earliest,
        latest,
        draw(y * width + x, stream, own.stamp, own.key),
    )
    return wp.vec3f(other, light_there, when)


@of_pixels(when=_has_moved, launch_bounds=(256, 4))  # docs/batch.md#on-a-gpu
def find_motion(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Write how each pixel moves between two frames, and which edge passes it."""
    motion = f.motion
    i = place(f.lens, n, y, x)
    before = place(f.lens, own.env, y, x)
    start, gain = _own_change(
        at(motion.depth, before),
        at(motion.late, i),
        at(motion.reflectivity, before),
        at(motion.late_reflectivity, i),
        seconds_between(own),
    )
    e = own.effects
    passing = passing_edge(
        f, own, n, y, x, e.motion_artefact_stretch, e.motion_artefact_stamp_at, _STREAM
    )
    put(motion.start, i, start)
    put(motion.gain, i, gain)
    put(motion.other, i, passing[0])
    put(motion.light, i, passing[1])
    put(motion.when, i, passing[2])


@of_pixels(when=_drops)
def drop(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Lose the pixels that an edge passes: the effect motion_dropout."""
    e = own.effects
    passing = passing_edge(
        f, own, n, y, x, e.motion_dropout_stretch, e.motion_dropout_stamp_at, _DROPOUT_STREAM
    )
    apart = wp.abs(passing[0] - at(f.motion.late, place(f.lens, n, y, x)))
    if passing[2] != 1.0 and apart > e.motion_dropout_step:
        put(f.out, place(f.lens, own.env, y, x), f.lens.invalid)


@wp.func
def _is_due(f: Frame, own: Own) -> wp.bool:
    return own.is_due


@of_pixels(when=_is_due)
def keep(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Keep what each pixel sees now."""
    i = place(f.lens, n, y, x)
    before = place(f.lens, own.env, y, x)
    put(f.motion.depth, before, at(f.motion.late, i))
    put(f.motion.reflectivity, before, at(f.motion.late_reflectivity, i))


@of_frequencies(when=_has_moved)
def shift_phases(f: Frame, own: Own, k: wp.int32, n: wp.int32, y: wp.int32, x: wp.int32):
    """Add to each frequency's shift what the motion between its raw frames adds."""
    motion = f.motion
    i = place(f.lens, n, y, x)
    tap = wp.float32(_TAPS * k)
    stretch = own.effects.motion_artefact_stretch
    stamp_at = own.effects.motion_artefact_stamp_at
    z = at(motion.late, i)
    shift = at(f.shifts, k * f.pitch + i)
    more = _motion_shift(
        z,
        at(motion.start, i),
        at(motion.gain, i),
        at(motion.other, i),
        at(motion.light, i),
        at(motion.when, i),
        moment(tap, own, stretch, stamp_at),
        moment(tap + 1.0, own, stretch, stamp_at),
        moment(tap + 2.0, own, stretch, stamp_at),
        moment(tap + 3.0, own, stretch, stamp_at),
        TURN * own.turns,
        shift,
    )
    put(f.shifts, k * f.pitch + i, wp.where(z > 0.0, shift + more, shift))


@wp.func
def _unwraps(f: Frame, own: Own) -> wp.bool:
    return _has_moved(f, own) and own.light.frequencies > 1


@of_pixels(when=_unwraps)
def unwrap(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Let frequencies that saw different surfaces agree on a distance."""
    i = place(f.lens, n, y, x)
    if at(f.motion.when, i) != 1.0:
        shifts = wp.vec3f()
        for k in range(3):
            if k < own.light.frequencies:
                shifts[k] = at(f.shifts, k * f.pitch + i)
        shifts = agreed(own.light, shifts, at(f.motion.late, i))
        for k in range(3):
            if k < own.light.frequencies:
                put(f.shifts, k * f.pitch + i, shifts[k])


def prepare(images: Images, num_envs: int) -> None:
    """Allocate memory for the frame before, and for what moves."""
    motion, device = Motion(), images.device
    kept = num_envs * images.height * images.width
    for name in Motion.vars:
        size = kept if name in ('depth', 'reflectivity') else images.pixels
        setattr(motion, name, wp.zeros(size, dtype=wp.float32, device=device))
    images.frame.motion = motion
    wp.load_module(__name__, device=device)


def see(images: Images) -> None:
    """Write what each pixel sees now, and where its edges are."""
    images.each_pixel(look)
    images.each_pixel(mark_edges)


def shift(images: Images) -> None:
    """Shift the phases of what moves between two frames."""
    for kernel in (find_motion, shift_phases, unwrap):
        images.each_pixel(kernel)

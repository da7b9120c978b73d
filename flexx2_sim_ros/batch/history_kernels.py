"""The effect time_offset as Warp kernels: earlier frames; see `effects.time_offset`."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.frame import Frame, NO, OPTIONS, place, YES
from flexx2_sim_ros.effects import between
import warp as wp

wp.set_module_options(OPTIONS)

_PER_NANOSECOND = wp.constant(wp.float32(1e-9))

_frames_around = compiled(between.frames_around)
_share_of = compiled(between.share_of)
_is_late_nearer = compiled(between.is_late_nearer)
_seen_between = compiled(between.seen_between)


@wp.struct
class History:
    """The clean frames of environments with wrong stamps, each with ``slots`` frames in turn."""

    places: wp.array(dtype=wp.int32)  # of each environment in the arrays below; -1 for none
    slots: wp.int32
    count: wp.array(dtype=wp.int32)  # of frames kept
    newest: wp.array(dtype=wp.int32)  # slot
    stamps: wp.array(dtype=wp.int64)  # by slot
    early: wp.array(dtype=wp.int32)  # slots of the frames before and after the moment shown,
    late: wp.array(dtype=wp.int32)
    nearer: wp.array(dtype=wp.int32)  # which of the two is nearer to it,
    share: wp.array(dtype=wp.float32)  # where it is between them, 0..1,
    seconds: wp.array(dtype=wp.float32)  # and the time between them
    depth: wp.array(dtype=wp.float32)  # by slot
    reflectivity: wp.array(dtype=wp.float32)  # by slot; empty while none was given


@wp.kernel
def find_moment(f: Frame, latencies: wp.array(dtype=wp.int64), history: History):
    """Keep the stamp of a new frame, and find the frames around the moment that it shows."""
    n = wp.tid()
    k = history.places[n]
    if k < 0 or f.is_due[n] == NO:
        return
    stamp = f.stamps[n]
    slots = history.slots
    newest = history.newest[k]
    count = wp.where(f.is_first[n] == YES, 0, history.count[k])
    if count == 0 or history.stamps[k * slots + newest] != stamp:
        newest = (newest + 1) % slots
        count = wp.min(count + 1, slots)
    history.stamps[k * slots + newest] = stamp
    history.newest[k] = newest
    history.count[k] = count
    moment = stamp - latencies[n]
    oldest = (newest + slots - count + 1) % slots
    early, late = _frames_around(history.stamps, k * slots, slots, oldest, count, moment)
    nearer = wp.int32(late)
    share = wp.float32(1.0)
    seconds = wp.float32(0.0)
    if late != early:
        start = history.stamps[k * slots + early]
        interval = history.stamps[k * slots + late] - start
        exact = _share_of(moment - start, interval)
        nearer = wp.where(_is_late_nearer(exact), late, early)
        share = wp.float32(exact)
        seconds = wp.float32(interval) * _PER_NANOSECOND
    history.early[k] = early
    history.late[k] = late
    history.nearer[k] = nearer
    history.share[k] = share
    history.seconds[k] = seconds


@wp.kernel
def look_back(
    f: Frame,
    given: wp.array(dtype=wp.float32),
    first_given: wp.int32,
    history: History,
    depth: wp.array(dtype=wp.float32),
    reflectivity: wp.array(dtype=wp.float32),
):
    """Keep the frame ``given``, and write what is seen at the moment to show."""
    n, y, c = wp.tid()
    k = wp.where(f.is_due[f.first + n] == YES, history.places[f.first + n], -1)
    x = first_of(c, f.chunk)
    end = end_of(c, f.chunk, f.lens.width)
    stride = stride_of(f.lens.width)
    source = place(f.lens, first_given + n, y, 0)
    shade = place(f.lens, f.surfaces.first_of_reflectivity + n, y, 0)
    target = place(f.lens, n, y, 0)
    newest = wp.int32(0)
    early = wp.int32(0)
    late = wp.int32(0)
    nearer = wp.int32(0)
    share = wp.float32(1.0)
    seconds = wp.float32(0.0)
    if k >= 0:
        frames = k * history.slots
        newest = place(f.lens, frames + history.newest[k], y, 0)
        early = place(f.lens, frames + history.early[k], y, 0)
        late = place(f.lens, frames + history.late[k], y, 0)
        nearer = place(f.lens, frames + history.nearer[k], y, 0)
        share = history.share[k]
        seconds = history.seconds[k]
    while x < end:
        z = at(given, source + x)
        if k >= 0:
            put(history.depth, newest + x, z)
            z = _seen_between(
                at(history.depth, early + x),
                at(history.depth, late + x),
                at(history.depth, nearer + x),
                share,
                seconds,
            )
        put(depth, target + x, z)
        if reflectivity.shape[0] > 0:
            rho = wp.float32(1.0)
            if f.surfaces.reflectivity.shape[0] > 0:
                rho = at(f.surfaces.reflectivity, shade + x)
            if k >= 0:
                put(history.reflectivity, newest + x, rho)
                rho = at(history.reflectivity, nearer + x)
            put(reflectivity, target + x, rho)
        x += stride

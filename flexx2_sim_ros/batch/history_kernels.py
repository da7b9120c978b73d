"""The effect time_offset as Warp kernels: earlier frames; see `effects.time_offset`."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.effect_formulas import Surfaces
from flexx2_sim_ros.batch.kernels import Lens, OPTIONS
from flexx2_sim_ros.effects import between
import warp as wp

wp.set_module_options(OPTIONS)

_PER_NANOSECOND = wp.constant(wp.float32(1e-9))
_YES = wp.constant(wp.uint8(1))
_NO = wp.constant(wp.uint8(0))

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
def find_moment(
    is_due: wp.array(dtype=wp.uint8),
    is_first: wp.array(dtype=wp.uint8),
    latencies: wp.array(dtype=wp.int64),
    stamps: wp.array(dtype=wp.int64),
    history: History,
):
    """Keep the stamp of a new frame, and find the frames around the moment that it shows."""
    n = wp.tid()
    k = history.places[n]
    if k < 0 or is_due[n] == _NO:
        return
    stamp = stamps[n]
    slots = history.slots
    newest = history.newest[k]
    count = wp.where(is_first[n] == _YES, 0, history.count[k])
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
    given: wp.array(dtype=wp.float32),
    first_given: wp.int32,
    surfaces: Surfaces,
    lens: Lens,
    first: wp.int32,
    chunk: wp.int32,
    is_due: wp.array(dtype=wp.uint8),
    history: History,
    depth: wp.array(dtype=wp.float32),
    reflectivity: wp.array(dtype=wp.float32),
):
    """Keep the frame ``given``, and write what is seen at the moment to show."""
    n, y, c = wp.tid()
    k = wp.where(is_due[first + n] == _YES, history.places[first + n], -1)
    pixels = lens.height * lens.width
    x = first_of(c, chunk)
    end = end_of(c, chunk, lens.width)
    stride = stride_of(lens.width)
    source = (first_given + n) * pixels + y * lens.width
    shade = (surfaces.first_of_reflectivity + n) * pixels + y * lens.width
    target = n * pixels + y * lens.width
    newest = wp.int32(0)
    early = wp.int32(0)
    late = wp.int32(0)
    nearer = wp.int32(0)
    share = wp.float32(1.0)
    seconds = wp.float32(0.0)
    if k >= 0:
        frames = k * history.slots
        newest = (frames + history.newest[k]) * pixels + y * lens.width
        early = (frames + history.early[k]) * pixels + y * lens.width
        late = (frames + history.late[k]) * pixels + y * lens.width
        nearer = (frames + history.nearer[k]) * pixels + y * lens.width
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
            if surfaces.reflectivity.shape[0] > 0:
                rho = at(surfaces.reflectivity, shade + x)
            if k >= 0:
                put(history.reflectivity, newest + x, rho)
                rho = at(history.reflectivity, nearer + x)
            put(reflectivity, target + x, rho)
        x += stride

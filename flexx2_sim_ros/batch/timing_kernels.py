"""When frames are taken and when they arrive, as Warp kernels."""

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.frame import Frame, NO, OPTIONS, place, YES
import warp as wp

wp.set_module_options(OPTIONS)

_NINE = wp.constant(wp.int64(9))
_TWENTY = wp.constant(wp.int64(20))
_ROUNDING = wp.constant(wp.int64(1000))  # nanoseconds: steps and delays are rounded


@wp.struct
class Timing:
    """The frames of every environment; the last ones are kept in ``slots`` images in turn."""

    step: wp.int64  # nanoseconds between two calls; 0: every call is the next frame
    slots: wp.int32  # 0: no frame is kept
    was_reset: wp.array(dtype=wp.uint8)  # 1: the next call takes the first frame
    last: wp.array(dtype=wp.int64)  # stamp of this call
    next_due: wp.array(dtype=wp.int64)  # when the next frame is due
    count: wp.array(dtype=wp.int32)  # of frames kept
    newest: wp.array(dtype=wp.int32)  # slot of the last frame
    arrived: wp.array(dtype=wp.int32)  # slot of the frame that the call returns
    taken: wp.array(dtype=wp.int64)  # stamp of the frame in each slot
    frames: wp.array(dtype=wp.float32)  # by slot


@wp.kernel
def begin(
    steps: wp.int64,
    timing: Timing,
    periods: wp.array(dtype=wp.int64),
    delays: wp.array(dtype=wp.int64),
    stamps: wp.array(dtype=wp.int64),
    is_due: wp.array(dtype=wp.uint8),
    image_stamps: wp.array(dtype=wp.int64),
):
    """
    Find which environments take a frame, by the rule of `FrameGate`, and what has arrived.

    ``stamps`` are for one step since the last call; with 0 steps, no time has passed.
    """
    n = wp.tid()
    period = periods[n]
    again = steps == wp.int64(0) and timing.was_reset[n] == NO
    stamp = wp.int64(stamps[n])
    if again:
        stamp = timing.last[n]
    if steps > wp.int64(1):
        stamp += (steps - wp.int64(1)) * wp.where(timing.step > wp.int64(0), timing.step, period)
    stamps[n] = stamp
    due = wp.int64(timing.next_due[n])
    early = (stamp - timing.last[n]) * _NINE / _TWENTY
    is_first = timing.was_reset[n] == YES or stamp < timing.last[n]
    if is_first:
        timing.count[n] = 0
        due = stamp
        early = wp.int64(0)
    takes = is_first or (not again and (timing.step == wp.int64(0) or stamp + early >= due))
    if takes:
        if stamp >= due + period:  # Due times passed without a call.
            due = stamp
        due += period
    timing.was_reset[n] = NO
    timing.last[n] = stamp
    timing.next_due[n] = due
    is_due[n] = wp.where(takes, YES, NO)
    if timing.slots == 0:
        image_stamps[n] = stamp
        return
    slots = timing.slots
    base = n * slots
    newest = timing.newest[n]
    count = timing.count[n]
    if takes:
        newest = (newest + 1) % slots
        count = wp.min(count + 1, slots)
        timing.taken[base + newest] = stamp
    # Before any frame has arrived, the first one is shown, as if the scene had stood still.
    arrived = (newest + slots - count + 1) % slots
    moment = stamp - delays[n] + _ROUNDING
    for k in range(1, count):
        slot = (newest + slots - count + 1 + k) % slots
        if timing.taken[base + slot] <= moment:
            arrived = slot
    timing.newest[n] = newest
    timing.count[n] = count
    timing.arrived[n] = arrived
    image_stamps[n] = timing.taken[base + arrived]


@wp.kernel
def exchange(f: Frame, timing: Timing, images: wp.array(dtype=wp.float32)):
    """Keep the frames that were taken, and write those that have arrived in their place."""
    n, y, c = wp.tid()
    own = place(f.lens, n, y, 0)
    newest = place(f.lens, n * timing.slots + timing.newest[n], y, 0)
    arrived = place(f.lens, n * timing.slots + timing.arrived[n], y, 0)
    takes = f.is_due[n] == YES
    begin = first_of(c, f.chunk)
    end = end_of(c, f.chunk, f.lens.width)
    stride = stride_of(f.lens.width)
    x = wp.int32(begin)
    if takes:
        while x < end:
            put(timing.frames, newest + x, at(images, own + x))
            x += stride
    if arrived != newest or not takes:
        x = wp.int32(begin)
        while x < end:
            put(images, own + x, at(timing.frames, arrived + x))
            x += stride


@wp.kernel
def tick(step: wp.int64, periods: wp.array(dtype=wp.int64), stamps: wp.array(dtype=wp.int64)):
    """Add the time between two calls to each environment's stamp."""
    n = wp.tid()
    stamps[n] = stamps[n] + wp.where(step > wp.int64(0), step, periods[n])


@wp.kernel
def forget(mask: wp.array(dtype=wp.bool), was_reset: wp.array(dtype=wp.uint8)):
    """Let the chosen environments begin with a first frame."""
    n = wp.tid()
    if mask[n]:
        was_reset[n] = YES

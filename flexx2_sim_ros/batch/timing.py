"""When each environment takes a frame, and when the frame arrives."""

from numbers import Real
from typing import Any

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.frame import Frame, NO, OPTIONS, place, YES
from flexx2_sim_ros.batch.images import check_kept, Images, launch, Rows
from flexx2_sim_ros.errors import InputError, shown
import numpy as np
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
    """Let the chosen environments begin with a first frame, of a camera or of its effects."""
    n = wp.tid()
    if mask[n]:
        was_reset[n] = YES


_LONGEST_STEP = 10.0  # seconds


class FrameTiming:
    """
    Frames at the rate of each mode, and a ring of the frames that are under way.

    `step_s` is the time between two calls, seconds; None: every call is the next frame. Raises
    InputError when it is no time. `image_stamps` are (N,) int64 nanoseconds on the device: of the
    frames that the last call returned.
    """

    def __init__(self, step_s: Any, rows: Rows, device: Any) -> None:
        """Start with a first frame in every environment; keep none."""
        number = isinstance(step_s, Real) and not isinstance(step_s, bool)
        if step_s is not None and not (number and 1e-6 <= step_s <= _LONGEST_STEP):
            raise InputError(
                f'step_s: must be 1e-6 to {_LONGEST_STEP:g} seconds, got {shown(step_s)}'
            )
        self._rows = rows
        num_envs = rows.stamps.size
        timing = self._timing = Timing()
        timing.step = 0 if step_s is None else round(float(step_s) * 1e9)
        timing.slots = 0
        timing.was_reset = wp.ones(num_envs, dtype=wp.uint8, device=device)
        timing.last, timing.next_due, self.image_stamps = (
            wp.zeros(num_envs, dtype=wp.int64, device=device) for _ in range(3)
        )
        timing.count, timing.newest, timing.arrived = (
            wp.zeros(num_envs, dtype=wp.int32, device=device) for _ in range(3)
        )
        timing.taken = wp.zeros(0, dtype=wp.int64, device=device)
        timing.frames = wp.zeros(0, dtype=wp.float32, device=device)
        self._holds = False
        self._shape: tuple[int, ...] = ()  # slots, height and width of what is kept, if it is
        wp.load_module(__name__, device=device)

    @property
    def step_ns(self) -> int:
        """Return the time between two calls; 0: every call is the next frame."""
        return int(self._timing.step)

    def keep(self, longest_ns: int, shortest_ns: int, images: Images, steps: Any) -> None:
        """
        Allocate the ring, unless it has the right shape; frames under way are then lost.

        `longest_ns` is the longest delay of an environment, `shortest_ns` the shortest period of a
        mode. Once `steps` (since the last call) is given, the last frames are kept, too. Raises
        InputError for another number of steps, and when the frames of all environments are too
        many.
        """
        timing, num_envs = self._timing, self._rows.stamps.size
        whole = isinstance(steps, int | np.integer) and not isinstance(steps, bool)
        if steps is not None and not (whole and 0 <= steps < 2**31):
            raise InputError(f'steps: must be a whole number from 0, got {shown(steps)}')
        self._holds |= steps is not None
        slots = frames_kept(longest_ns, shortest_ns, self.step_ns) or int(self._holds)
        size = slots * num_envs * images.height * images.width
        check_kept('time_offset.delay', longest_ns, size)
        shape = (slots, images.height, images.width) if slots else ()
        if shape == self._shape:
            return
        self._shape = shape
        device = self._rows.stamps.device
        timing.slots = slots
        timing.taken = wp.zeros(slots * num_envs, dtype=wp.int64, device=device)
        timing.frames = wp.zeros(size, dtype=wp.float32, device=device)
        timing.was_reset.fill_(1)

    def begin(self, steps: int | None) -> None:
        """Begin a call: write which environments take a frame to ``rows.is_due``."""
        rows, passed = self._rows, 1 if steps is None else int(steps)
        arrays = rows.periods, rows.delays, rows.stamps, rows.is_due, self.image_stamps
        launch(begin, rows.stamps.size, passed, self._timing, *arrays)

    def exchange(self, images: Images, out: wp.array) -> None:
        """Keep the frames in ``out``, (N * H * W,) float32, and write what has arrived there."""
        if self._timing.slots:
            grid = images.grid(self._rows.stamps.size)
            launch(exchange, grid, images.frame, self._timing, out)

    def end(self) -> None:
        """Move the stamps to the next call."""
        rows = self._rows
        launch(tick, rows.stamps.size, self._timing.step, rows.periods, rows.stamps)

    def forget(self, mask: wp.array) -> None:
        """Let environments begin with a first frame; ``mask`` is (N,) bool on the device."""
        launch(forget, mask.size, mask, self._timing.was_reset)


def frames_kept(longest_ns: int, shortest_ns: int, step_ns: int) -> int:
    """
    Return how many frames an environment keeps; 0 if each is returned by the call that takes it.

    `longest_ns` is the longest delay, `shortest_ns` the shortest period of a mode and `step_ns`
    the time between two calls; 0: every call is the next frame.
    """
    if not longest_ns and not step_ns:
        return 0
    # Frames are at least this far apart, but for one step, since they are taken at a call.
    interval = max(shortest_ns, step_ns)
    slack = step_ns if step_ns < shortest_ns else 0
    under_way = (longest_ns + slack - 1) // interval + 1 if longest_ns else 0
    return under_way + 1  # and the one that has arrived

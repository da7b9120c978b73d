"""When each environment takes a frame, and when the frame arrives."""

from numbers import Real
from typing import Any

from flexx2_sim_ros.batch import timing_kernels
from flexx2_sim_ros.batch.images import check_kept, Images, launch, Rows
from flexx2_sim_ros.errors import InputError, shown
import numpy as np
import warp as wp

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
        timing = self._timing = timing_kernels.Timing()
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
        wp.load_module(timing_kernels, device=device)

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
        launch(timing_kernels.begin, rows.stamps.size, passed, self._timing, *arrays)

    def exchange(self, images: Images, out: wp.array) -> None:
        """Keep the frames in ``out``, (N * H * W,) float32, and write what has arrived there."""
        if self._timing.slots:
            grid = images.grid(self._rows.stamps.size)
            launch(timing_kernels.exchange, grid, images.frame, self._timing, out)

    def end(self) -> None:
        """Move the stamps to the next call."""
        rows = self._rows
        launch(timing_kernels.tick, rows.stamps.size, self._timing.step, rows.periods, rows.stamps)

    def forget(self, mask: wp.array) -> None:
        """Let environments begin with a first frame; ``mask`` is (N,) bool on the device."""
        launch(timing_kernels.forget, mask.size, mask, self._timing.was_reset)


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

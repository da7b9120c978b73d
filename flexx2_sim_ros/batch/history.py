"""
The effect time_offset in a batch: earlier frames of the environments that have it.

See `effects.time_offset`.
"""

from collections.abc import Sequence
import math
from typing import Any

from flexx2_sim_ros.batch.arrays import at, end_of, first_of, put, stride_of
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.frame import Frame, NO, OPTIONS, place, YES
from flexx2_sim_ros.batch.images import check_kept, Images, launch
from flexx2_sim_ros.effects import between, Effect
from flexx2_sim_ros.effects.time_offset import FRAMES_KEPT
import numpy as np
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


class FrameHistory:
    """
    Memory for earlier frames, as many as the longest latency needs in the fastest mode.

    `effects` are of every environment; `latest_ns` is the longest latency that one may have.
    Raises InputError when the frames of all environments are too many.
    """

    def __init__(
        self, effects: Sequence[Sequence[Effect]], latest_ns: int, images: Images
    ) -> None:
        """Allocate it, but not for reflectivity, which may never be given."""
        self._images, device = images, images.device
        self._pixels = images.height * images.width
        chosen = [one is not None for one in each_with('history', effects)]
        interval = 1e9 / max(mode.rate_hz for mode in images.profile.modes)
        slots = min(max(math.ceil(latest_ns / interval) + 1, 2), FRAMES_KEPT)
        self._frames = slots * sum(chosen)
        check_kept('time_offset.latency', latest_ns, self._frames * self._pixels)

        def array(values: Any, dtype: Any) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        history = self._history = History()
        history.places = array(places_of(chosen), wp.int32)
        history.slots = slots
        history.stamps = array(np.zeros(self._frames), wp.int64)
        for name in ('count', 'newest', 'early', 'late', 'nearer'):
            setattr(history, name, array(np.zeros(sum(chosen)), wp.int32))
        for name in ('share', 'seconds'):
            setattr(history, name, array(np.zeros(sum(chosen)), wp.float32))
        history.depth = wp.zeros(self._frames * self._pixels, dtype=wp.float32, device=device)
        history.reflectivity = wp.zeros(0, dtype=wp.float32, device=device)
        self._depth = wp.zeros(images.pixels, dtype=wp.float32, device=device)
        self._reflectivity = wp.zeros(0, dtype=wp.float32, device=device)
        wp.load_module(__name__, device=device)

    def begin(self, with_reflectivity: bool) -> None:
        """Register a new frame in all environments that take one, and whether it has colours."""
        history = self._history
        if with_reflectivity and not history.reflectivity.size:
            history.reflectivity = wp.full_like(history.depth, 1.0)
            self._reflectivity = wp.full_like(self._depth, 1.0)
        images, rows = self._images, self._images.rows
        launch(find_moment, rows.stamps.size, images.frame, rows.latencies, history)

    def look_back(self, depth: wp.array, first: int) -> tuple[wp.array, wp.array]:
        """
        Keep the frames of the pass, and return depth and reflectivity that its environments see.

        `depth` are flat float32 images; that of the first environment is at `first`. The results
        are flat, too; reflectivity is empty while it was never given.
        """
        seen = self._depth, self._reflectivity
        self._images.each_pixel(look_back, depth, first, self._history, *seen)
        return seen


def needs_of(effects: Sequence[Sequence[Effect]]) -> set[str]:
    """Return all that the effects need in the kernels; see ``Effect.batched``."""
    return {need for own in effects for effect in own for need in effect.batched or ()}


def each_with(need: str, effects: Sequence[Sequence[Effect]]) -> list[Any]:
    """Return of every environment the effect with this entry in ``batched``, or None."""
    return [
        next((effect for effect in own if need in (effect.batched or ())), None) for own in effects
    ]


def places_of(chosen: Sequence[bool]) -> np.ndarray:
    """Return the place of each environment among the chosen ones, -1 for the others; int32."""
    return np.where(chosen, np.cumsum(chosen) - 1, -1).astype(np.int32)

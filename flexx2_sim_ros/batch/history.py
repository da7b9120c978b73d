"""The effect time_offset in a batch: earlier frames of the environments that have it."""

from collections.abc import Sequence
import math
from typing import Any

from flexx2_sim_ros.batch import history_kernels
from flexx2_sim_ros.batch.images import check_kept, Images, launch, Rows
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.effects.time_offset import FRAMES_KEPT
import numpy as np
import warp as wp


class FrameHistory:
    """
    Memory for earlier frames, as many as the longest latency needs in the fastest mode.

    `effects` are of every environment; `latest_ns` is the longest latency that one may have;
    `profile` gives the time between frames. Raises InputError when the frames of all environments
    are too many.
    """

    def __init__(
        self,
        effects: Sequence[Sequence[Effect]],
        latest_ns: int,
        profile: Profile,
        images: Images,
        rows: Rows,
    ) -> None:
        """Allocate it, but not for reflectivity, which may never be given."""
        self._images, self._rows, device = images, rows, rows.stamps.device
        self._pixels = images.height * images.width
        chosen = [one is not None for one in each_with('history', effects)]
        interval = 1e9 / max(mode.rate_hz for mode in profile.modes)
        slots = min(max(math.ceil(latest_ns / interval) + 1, 2), FRAMES_KEPT)
        self._frames = slots * sum(chosen)
        check_kept('time_offset.latency', latest_ns, self._frames * self._pixels)

        def array(values: Any, dtype: Any) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        history = self._history = history_kernels.History()
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
        wp.load_module(history_kernels, device=device)

    def begin(self, with_reflectivity: bool) -> None:
        """Register a new frame in all environments that take one, and whether it has colours."""
        history = self._history
        if with_reflectivity and not history.reflectivity.size:
            history.reflectivity = wp.full_like(history.depth, 1.0)
            self._reflectivity = wp.full_like(self._depth, 1.0)
        rows = self._rows
        frame = self._images.frame
        launch(history_kernels.find_moment, rows.stamps.size, frame, rows.latencies, history)

    def look_back(self, depth: wp.array, first: int) -> tuple[wp.array, wp.array]:
        """
        Keep the frames of the pass, and return depth and reflectivity that its environments see.

        `depth` are flat float32 images; that of the first environment is at `first`. The results
        are flat, too; reflectivity is empty while it was never given.
        """
        seen = self._depth, self._reflectivity
        self._images.each_pixel(history_kernels.look_back, depth, first, self._history, *seen)
        return seen


def each_with(need: str, effects: Sequence[Sequence[Effect]]) -> list[Any]:
    """Return of every environment the effect with this entry in ``batched``, or None."""
    return [
        next((effect for effect in own if need in (effect.batched or ())), None) for own in effects
    ]


def places_of(chosen: Sequence[bool]) -> np.ndarray:
    """Return the place of each environment among the chosen ones, -1 for the others; int32."""
    return np.where(chosen, np.cumsum(chosen) - 1, -1).astype(np.int32)

"""The effect multipath in a batch: light that was reflected twice."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import bounce_kernels
from flexx2_sim_ros.batch.history import places_of
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.effects.interreflection import PATCH_FIELDS, RECEIVER, SENDER
import warp as wp


class IndirectLight:
    """
    What the patches of the environments' images send to each other.

    Parameters
    ----------
    chosen : sequence of bool
        Which environments have the effect.
    frequencies : int
        The most modulation frequencies of a mode.
    images : Images
    device : warp.Device

    """

    def __init__(
        self, chosen: Sequence[bool], frequencies: int, images: Images, device: Any
    ) -> None:
        """Allocate what is kept of each chosen environment."""
        self._images = images
        envs = sum(chosen)

        def zeros(size: int) -> wp.array:
            return wp.zeros(size, dtype=wp.float32, device=device)

        bounce = self._bounce = bounce_kernels.Bounce()
        bounce.places = wp.array(places_of(chosen), dtype=wp.int32, device=device)
        bounce.changed = wp.zeros(envs, dtype=wp.uint8, device=device)
        self._senders, self._receivers = (
            (-(-images.height // side), -(-images.width // side)) for side in (SENDER, RECEIVER)
        )
        bounce.sender_count = self._senders[0] * self._senders[1]
        bounce.receiver_count = self._receivers[0] * self._receivers[1]
        bounce.frequencies = frequencies
        bounce.senders = zeros(envs * PATCH_FIELDS * bounce.sender_count)
        bounce.receivers = zeros(envs * PATCH_FIELDS * bounce.receiver_count)
        bounce.indirect = zeros(envs * frequencies * 2 * bounce.receiver_count)
        bounce.fields = 2 + 4 * frequencies
        bounce.wide = zeros(images.count * bounce.fields * self._receivers[0] * images.width)
        wp.load_module(bounce_kernels, device=device)

    def begin(self, is_first: wp.array) -> None:
        """Register a new frame in all environments; ``is_first`` is (N,) uint8."""
        launch(bounce_kernels.begin, is_first.size, is_first, self._bounce)

    def add(
        self,
        surfaces: Any,
        first: int,
        count: int,
        effects: wp.array,
        lights: wp.array,
        phasors: Any,
    ) -> None:
        """Add the indirect light to the pixels of some environments; see `PixelLight.find`."""
        bounce, lens = self._bounce, self._images.lens
        for side, blocks, patches in (
            (SENDER, self._senders, bounce.senders),
            (RECEIVER, self._receivers, bounce.receivers),
        ):
            launch(
                bounce_kernels.find_patches,
                (count, *blocks),
                surfaces,
                lens,
                first,
                side,
                bounce,
                patches,
            )
        threads = (count, bounce.receiver_count)
        if self._images.lists:
            launch(bounce_kernels.gather_all, threads, first, lights, bounce)
        else:
            each = (*threads, bounce.frequencies)
            launch(bounce_kernels.gather, each, first, lights, bounce)
        grid, chunk = self._images.grid(count)
        wide = (count, self._receivers[0], grid[2])
        launch(bounce_kernels.widen, wide, lens, first, chunk, lights, bounce)
        launch(
            bounce_kernels.add_bounce,
            grid,
            surfaces,
            lens,
            first,
            chunk,
            effects,
            lights,
            bounce,
            phasors,
        )

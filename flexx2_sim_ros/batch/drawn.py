"""A pool of cameras drawn from a randomisation; each environment has one of them."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import drawn_kernels
from flexx2_sim_ros.batch.effect_tables import Effects, effects_row
from flexx2_sim_ros.batch.images import launch, Rows
from flexx2_sim_ros.effects import Effect, Randomisation
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError, shown
import numpy as np
import warp as wp

# What an effect has these for is computed once, when the batch is set up.
_ONCE = {'pose', 'view', 'edges'}
_MOST = 1_000_000


class DrawnCameras:
    """
    Which camera each environment has.

    Parameters
    ----------
    randomisation : Randomisation
        What is drawn from.
    num_envs : int
        N.
    seed : int
        Of the pool and of which cameras environments get.
    pool : int
        How many cameras are drawn in all. An environment gets any of them.
    device : warp.Device

    Attributes
    ----------
    cameras : list of tuple of Effect
        The pool.
    drawn : warp.array
        (N,) int32 on the device: which camera of the pool each environment has; -1 where it has
        effects of its own.
    effects : tuple of Effect
        All effects that a camera of the pool may have.

    Raises
    ------
    InputError
        For effects that cannot be drawn again while the batch runs.

    """

    def __init__(
        self, randomisation: Randomisation, num_envs: int, seed: int, pool: int, device: Any
    ) -> None:
        """Draw the pool, put it on the device, and give each environment a camera."""
        if not 0 < pool <= _MOST:
            raise InputError(f'pool: must be from 1 to {_MOST}, got {shown(pool)}')
        self.effects = randomisation.effects
        _check(randomisation)
        self.cameras: list[tuple[Effect, ...]] = randomisation.draw(pool, seed)
        self._seed = seed % 2**30
        self._pool = _on_device(self.cameras, device)
        offsets = [time_offset_of(own) for own in self.cameras]
        self._latencies, self._delays = (
            wp.array(values, dtype=wp.int64, device=device)
            for values in ([o.latency_ns for o in offsets], [o.delay_ns for o in offsets])
        )
        self._counts, self.drawn = (
            wp.zeros(num_envs, dtype=wp.int32, device=device) for _ in range(2)
        )
        wp.load_module(drawn_kernels, device=device)
        with wp.ScopedDevice(device):
            self.draw(wp.ones(num_envs, dtype=wp.bool, device=device))

    @property
    def drawing(self) -> np.ndarray:
        """Return (N,) bool: which environments have a camera of the pool."""
        return self.drawn.numpy() >= 0

    def leave(self, chosen: np.ndarray) -> bool:
        """Draw no camera for the chosen environments (N,) anymore; return whether any are left."""
        self.drawn.assign(np.where(chosen, -1, self.drawn.numpy()).astype(np.int32))
        return bool(self.drawing.any())

    def draw(self, mask: wp.array) -> None:
        """Draw another camera for environments; ``mask`` is (N,) bool on the device."""
        parts = self._pool, self._seed, self._counts, self.drawn
        launch(drawn_kernels.draw, mask.size, mask, *parts)

    def give(self, mask: wp.array, rows: Rows) -> None:
        """Write the effects of their cameras into the rows of the chosen environments."""
        pool = self._pool, self.drawn, self._latencies, self._delays
        own = rows.effects, rows.latencies, rows.delays
        launch(drawn_kernels.take, mask.size, mask, *pool, *own)


def _on_device(cameras: Sequence[Sequence[Effect]], device: Any) -> wp.array:
    rows = np.array([effects_row(own) for own in cameras])
    return wp.array(rows, dtype=Effects, device=device)


def _check(randomisation: Randomisation) -> None:
    drawn = {(one.effect, one.parameter) for one in randomisation.distributions}
    for effect in randomisation.effects:
        needs = set(effect.batched or ())
        # The kernel of scattered light is computed once from its width.
        kernel = 'scatter' in needs and (effect.name, 'width') in drawn
        if kernel or _ONCE & needs or not effect.has_kernel:
            raise InputError(
                f'randomisation: {effect.name}: cannot be drawn again while a batch runs; draw '
                'once, with set_effects(randomisation.draw(num_envs, seed))'
            )

"""A pool of cameras drawn from a randomisation; each environment has one of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from flexx2_sim_ros.batch.effect_tables import Effects, effects_row
from flexx2_sim_ros.batch.frame import OPTIONS
from flexx2_sim_ros.batch.images import launch, Rows
from flexx2_sim_ros.effects import Effect, Randomisation
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError, shown
import numpy as np
import warp as wp

wp.set_module_options(OPTIONS)


@wp.kernel
def draw(
    mask: wp.array(dtype=wp.bool),
    pool: wp.array(dtype=Effects),
    seed: wp.int32,
    counts: wp.array(dtype=wp.int32),
    drawn: wp.array(dtype=wp.int32),
):
    """Draw another camera of the pool for each chosen environment that draws its cameras."""
    i = wp.tid()
    if mask[i] and drawn[i] >= 0:
        state = wp.rand_init(seed + i, counts[i])
        drawn[i] = wp.int32(wp.randu(state) % wp.uint32(pool.shape[0]))
        counts[i] = counts[i] + 1


@wp.kernel
def take(
    mask: wp.array(dtype=wp.bool),
    pool: wp.array(dtype=Effects),
    drawn: wp.array(dtype=wp.int32),
    pool_latencies: wp.array(dtype=wp.int64),
    pool_delays: wp.array(dtype=wp.int64),
    effects: wp.array(dtype=Effects),
    latencies: wp.array(dtype=wp.int64),
    delays: wp.array(dtype=wp.int64),
):
    """Give each chosen environment the effects of its camera, and its `TimeOffset`."""
    i = wp.tid()
    if mask[i] and drawn[i] >= 0:
        k = drawn[i]
        effects[i] = pool[k]
        latencies[i] = pool_latencies[k]
        delays[i] = pool_delays[k]


# What an effect has these for is computed once, when the batch is set up.
_ONCE = {'pose', 'view', 'edges'}
_MOST = 1_000_000


class DrawnCameras:
    """
    Which camera of a pool each of N environments has.

    The `pool` is how many cameras are drawn in all; an environment gets any of them. ``seed`` is
    that of the pool and of which cameras environments get. Raises InputError for effects that
    cannot be drawn again while the batch runs.

    Attributes
    ----------
    cameras : list of tuple of Effect
        The pool.
    drawn : warp.array
        (N,) int32 on the device: each environment's camera; -1 where it has effects of its own.
    effects : tuple of Effect
        All effects that a camera of the pool may have.

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
        self._rows: Rows | None = None
        self._pool = wp.zeros(pool, dtype=Effects, device=device)
        self._latencies, self._delays = (
            wp.zeros(pool, dtype=wp.int64, device=device) for _ in range(2)
        )
        self._write(self.cameras)
        self._counts, self.drawn = (
            wp.zeros(num_envs, dtype=wp.int32, device=device) for _ in range(2)
        )
        wp.load_module(__name__, device=device)
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
        launch(draw, mask.size, mask, *parts)

    def scale(self, share: float) -> None:
        """Multiply the strengths of all cameras, as they were drawn, by 0 to 1."""
        self._write(
            [
                tuple(replace(effect, strength=share * effect.strength) for effect in own)
                for own in self.cameras
            ]
        )
        self._give_all()

    def _write(self, cameras: Sequence[Sequence[Effect]]) -> None:
        offsets = [time_offset_of(own) for own in cameras]
        self._pool.assign(np.array([effects_row(own) for own in cameras]))
        self._latencies.assign(np.array([one.latency_ns for one in offsets]))
        self._delays.assign(np.array([one.delay_ns for one in offsets]))

    def state(self) -> dict[str, list[int]]:
        """Return which camera each environment has, and how many it has had."""
        return {'drawn': self.drawn.numpy().tolist(), 'counts': self._counts.numpy().tolist()}

    def restore(self, state: Mapping[str, Sequence[int]]) -> None:
        """Give each environment the camera that it had when `state` returned this."""
        self.drawn.assign(np.array(state['drawn'], np.int32))
        self._counts.assign(np.array(state['counts'], np.int32))
        self._give_all()

    def _give_all(self) -> None:
        if self._rows is not None:
            with wp.ScopedDevice(self.drawn.device):
                self.give(wp.ones(self.drawn.size, dtype=wp.bool), self._rows)
        wp.synchronize_device(self.drawn.device)  # The next frame may be of another stream.

    def give(self, mask: wp.array, rows: Rows) -> None:
        """Write the effects of their cameras into the rows of the chosen environments."""
        self._rows = rows
        pool = self._pool, self.drawn, self._latencies, self._delays
        own = rows.effects, rows.latencies, rows.delays
        launch(take, mask.size, mask, *pool, *own)


def can_be_drawn_again(effect: Effect) -> bool:
    """Return whether an effect, as it is, may change its strength while a batch runs."""
    return effect.has_kernel and not _ONCE & set(effect.batched or ())


def _check(randomisation: Randomisation) -> None:
    drawn = {(one.effect, one.parameter) for one in randomisation.distributions}
    for effect in randomisation.effects:
        # The kernel of scattered light is computed once from its width.
        kernel = 'scatter' in (effect.batched or ()) and (effect.name, 'width') in drawn
        if kernel or not can_be_drawn_again(effect):
            raise InputError(
                f'randomisation: {effect.name}: cannot be drawn again while a batch runs; draw '
                'once, with set_effects(randomisation.draw(num_envs, seed))'
            )

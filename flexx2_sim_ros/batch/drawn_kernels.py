"""Drawing a camera for an environment, as Warp kernels."""

from flexx2_sim_ros.batch.effect_tables import Effects
from flexx2_sim_ros.batch.kernels import OPTIONS
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
    """Draw another camera of the pool for each chosen environment."""
    i = wp.tid()
    if mask[i]:
        state = wp.rand_init(seed + i, counts[i])
        drawn[i] = wp.int32(wp.randu(state) % wp.uint32(pool.shape[0]))
        counts[i] = counts[i] + 1


@wp.kernel
def take(
    mask: wp.array(dtype=wp.bool),
    pool: wp.array(dtype=Effects),
    drawn: wp.array(dtype=wp.int32),
    rows: wp.array(dtype=Effects),
):
    """Give each chosen environment the effects of its camera."""
    i = wp.tid()
    if mask[i]:
        rows[i] = pool[drawn[i]]

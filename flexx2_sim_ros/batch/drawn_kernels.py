"""Drawing a camera for an environment, as Warp kernels."""

from flexx2_sim_ros.batch.effect_tables import Effects
from flexx2_sim_ros.batch.frame import OPTIONS
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

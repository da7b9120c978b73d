"""What is kept of environments between frames, and images between kernels, as Warp structs."""

from flexx2_sim_ros.batch.kernels import OPTIONS
import warp as wp

wp.set_module_options(OPTIONS)

_YES = wp.constant(wp.uint8(1))
_NO = wp.constant(wp.uint8(0))


@wp.struct
class Kept:
    """What is kept of every environment between frames; arrays of unused effects are empty."""

    is_due: wp.array(dtype=wp.uint8)  # 0: no frame is taken now, and nothing is kept of it
    was_reset: wp.array(dtype=wp.uint8)  # 1: the next frame is the first one
    is_first: wp.array(dtype=wp.uint8)  # 1: this is the first frame
    started: wp.array(dtype=wp.int64)  # stamp of the first frame
    last: wp.array(dtype=wp.int64)  # stamp of this frame
    before: wp.array(dtype=wp.int64)  # stamp of the frame before
    measured: wp.array(dtype=wp.float32)  # for temporal_filter
    grain: wp.array(dtype=wp.float32)  # for fixed_pattern


@wp.struct
class PassImages:
    """Images of the pass between the kernels, flat, without borders."""

    facing: wp.array(dtype=wp.float32)  # cosine of incidence, before edges move
    expected: wp.array(dtype=wp.float32)  # sigma_z, before edges move
    normals: wp.array(dtype=wp.float32)  # whole blocks of four; empty: to be drawn
    chances: wp.array(dtype=wp.float32)  # uniform numbers; whole blocks of four
    measured: wp.array(dtype=wp.float32)
    filtered: wp.array(dtype=wp.float32)
    sigma: wp.array(dtype=wp.float32)
    cosine: wp.array(dtype=wp.float32)
    amplitude: wp.array(dtype=wp.float32)
    depth: wp.array(dtype=wp.float32)


@wp.kernel
def begin(kept: Kept, stamps: wp.array(dtype=wp.int64)):
    """Register a new frame; a stamp earlier than the latest one starts the environment again."""
    n = wp.tid()
    stamp = stamps[n]
    kept.is_first[n] = _NO
    if kept.is_due[n] == _NO:
        return
    if kept.was_reset[n] == _YES or stamp < kept.last[n]:
        kept.is_first[n] = _YES
        kept.started[n] = stamp
    kept.was_reset[n] = _NO
    kept.before[n] = kept.last[n]
    kept.last[n] = stamp


@wp.kernel
def forget(mask: wp.array(dtype=wp.bool), was_reset: wp.array(dtype=wp.uint8)):
    """Reset the chosen environments."""
    n = wp.tid()
    if mask[n]:
        was_reset[n] = _YES

"""The kernel that blanks what lies outside of a camera's valid region."""

from flexx2_sim_ros.batch.kernels import OPTIONS
import warp as wp

wp.set_module_options(OPTIONS)


@wp.kernel
def blank_outside(
    outside: wp.array(dtype=wp.bool), invalid: wp.float32, out: wp.array(dtype=wp.float32)
):
    """Write ``invalid`` where ``outside``, (H * W,), is true, in every environment."""
    n, i = wp.tid()
    if outside[i]:
        out[n * outside.shape[0] + i] = invalid

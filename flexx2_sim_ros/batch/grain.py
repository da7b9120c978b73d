"""The grain of the effect fixed_pattern, made once; see `effects.fixed_pattern`."""

from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled, counter_of, four_normals
from flexx2_sim_ros.batch.frame import Frame, OPTIONS, place
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.effects import fixed_pattern
import warp as wp

wp.set_module_options(OPTIONS)

_STREAM = wp.constant(wp.uint32(fixed_pattern.FixedPattern.stream))

_less_mean = compiled(fixed_pattern.less_mean)
_to_unit_variance = compiled(fixed_pattern.to_unit_variance)


@wp.kernel
def white_noise(f: Frame, out: wp.array(dtype=wp.float32)):
    """Write four of an environment's normals."""
    n, block = wp.tid()
    pixels = f.lens.height * f.lens.width
    four = four_normals(counter_of(block, _STREAM, wp.int64(0)), f.keys[n])
    for k in range(4):
        if 4 * block + k < pixels:
            put(out, n * pixels + 4 * block + k, four[k])


@wp.kernel
def less_its_mean(f: Frame, white: wp.array(dtype=wp.float32)):
    """Write a pixel's noise less the mean over the 5 x 5 pixels around."""
    n, y, x = wp.tid()
    height, width = f.lens.height, f.lens.width
    put(
        f.grain, place(f.lens, n, y, x), _less_mean(white, n * height * width, height, width, y, x)
    )


@wp.kernel
def to_unit_variance(f: Frame):
    """Scale an environment's grain."""
    n = wp.tid()
    grain = f.grain
    pixels = f.lens.height * f.lens.width
    total = wp.float64(0.0)
    squares = wp.float64(0.0)
    i = n * pixels
    while i < (n + 1) * pixels:
        value = wp.float64(at(grain, i))
        total += value
        squares += value * value
        i += 1
    scale = wp.float32(_to_unit_variance(total, squares, wp.float64(pixels)))
    i = n * pixels
    while i < (n + 1) * pixels:
        put(grain, i, at(grain, i) * scale)
        i += 1


def make_grain(images: Images, num_envs: int) -> None:
    """Write the grain of so many environments to the frame, which has room for it."""
    frame = images.frame
    white = wp.empty_like(frame.grain)
    with wp.ScopedDevice(white.device):
        launch(white_noise, (num_envs, images.blocks), frame, white)
        launch(less_its_mean, (num_envs, images.height, images.width), frame, white)
        launch(to_unit_variance, num_envs, frame)

"""What `height_grid` and `rendering` do on the device, as Warp kernels."""

from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.frame import OPTIONS
from flexx2_sim_ros.consumers.height_grid import from_cell, nearest_cell
import warp as wp

wp.set_module_options(OPTIONS)

_nearest_cell = compiled(nearest_cell)
_from_cell = compiled(from_cell)


@wp.kernel
def add_points(
    depth: wp.array3d(dtype=wp.float32),
    focal: wp.vec2f,
    centre: wp.vec2f,
    position: wp.array(dtype=wp.vec3f),
    rotation: wp.array(dtype=wp.mat33f),
    first: wp.vec2f,
    pitch: wp.float32,
    reach: wp.float32,
    total: wp.array3d(dtype=wp.float32),
    count: wp.array3d(dtype=wp.float32),
):
    """Add the point of a pixel to the cell it lies in, if it lies near the middle."""
    n, v, u = wp.tid()
    z = depth[n, v, u]
    if not z > 0.0:
        return
    ray = wp.vec3f(
        (wp.float32(u) - centre[0]) / focal[0], (wp.float32(v) - centre[1]) / focal[1], 1.0
    )
    point = position[n] + rotation[n] * (z * ray)
    row = _nearest_cell(point[0], first[0], pitch)
    column = _nearest_cell(point[1], first[1], pitch)
    i, j = wp.int32(row), wp.int32(column)
    if i < 0 or j < 0 or i >= total.shape[1] or j >= total.shape[2]:
        return
    across = wp.max(
        _from_cell(point[0], first[0], pitch, row), _from_cell(point[1], first[1], pitch, column)
    )
    if across <= reach:
        wp.atomic_add(total, n, i, j, point[2])
        wp.atomic_add(count, n, i, j, 1.0)


@wp.kernel
def mean(
    total: wp.array3d(dtype=wp.float32),
    count: wp.array3d(dtype=wp.float32),
    least: wp.float32,
    out: wp.array3d(dtype=wp.float32),
):
    """Write the mean height in a cell, NaN below ``least`` points."""
    n, i, j = wp.tid()
    seen = count[n, i, j]
    out[n, i, j] = wp.where(seen >= least, total[n, i, j] / wp.max(seen, 1.0), wp.nan)


@wp.kernel
def unpack(
    images: wp.array2d(dtype=wp.float32), offset: wp.int32, out: wp.array3d(dtype=wp.float32)
):
    """Copy one camera's images from those of all cameras of an environment."""
    n, v, u = wp.tid()
    out[n, v, u] = images[n, offset + v * out.shape[2] + u]

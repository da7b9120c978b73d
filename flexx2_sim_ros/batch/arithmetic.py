"""Formulas of `formulas.fastmath` and `formulas.random_numbers` as Warp's kernels call them."""

from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.formulas import fastmath, random_numbers
from flexx2_sim_ros.physics import philox
import warp as wp

arccos = compiled(fastmath.arccos)
log_from_zero = compiled(fastmath.log_from_zero)
uniform = compiled(random_numbers.uniform)
_philox4x32 = compiled(random_numbers.philox4x32)
_normal_pair = compiled(random_numbers.normal_pair)
_unit_draw = compiled(random_numbers.unit_draw)


@wp.func
def philox4x32(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4ui:
    """Return four uint32 for a counter of four and a key of two uint32."""
    u0, u1, u2, u3 = _philox4x32(counter[0], counter[1], counter[2], counter[3], key[0], key[1])
    return wp.vec4ui(u0, u1, u2, u3)


@wp.func
def counter_of(index: wp.int32, stream: wp.uint32, stamp: wp.int64) -> wp.vec4ui:
    """Return the counter of block ``index`` of a stream at a stamp."""
    return wp.vec4ui(wp.uint32(index), stream, wp.uint32(stamp), wp.uint32(stamp >> wp.int64(32)))


@wp.func
def four_normals(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4f:
    """Return the four standard normals of one counter."""
    u = philox4x32(counter, key)
    a, b = _normal_pair(u[0], u[1])
    c, d = _normal_pair(u[2], u[3])
    return wp.vec4f(a, b, c, d)


@wp.func
def one_of(values: wp.vec4f, which: wp.int32) -> wp.float32:
    """Return an element; a plain index would put the vector into memory on CUDA."""
    return wp.where(
        which < 2,
        wp.where(which == 0, values[0], values[1]),
        wp.where(which == 2, values[2], values[3]),
    )


@wp.func
def edge_draw(counter: wp.vec4ui, key: wp.vec2ui, laplace: wp.float32) -> wp.float32:
    """Return a draw of unit variance: normal, or with probability ``laplace`` Laplacian."""
    u = philox4x32(counter, key)
    return _unit_draw(u[0], u[1], u[2], u[3], laplace)


# What the numbers are for, as in `physics.philox`.
AXIAL = wp.constant(wp.uint32(philox.STREAM_AXIAL))
ROW_EDGES = wp.constant(wp.uint32(philox.STREAM_ROW_EDGES))
COLUMN_EDGES = wp.constant(wp.uint32(philox.STREAM_COLUMN_EDGES))

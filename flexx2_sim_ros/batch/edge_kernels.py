"""Lateral noise as Warp kernels: edges that jitter as a whole; see `physics.lateral`."""

from flexx2_sim_ros.batch.arrays import at_byte, put_byte, put_least
from flexx2_sim_ros.batch.compiled import COLUMN_EDGES, compiled, counter_of, edge_draw, ROW_EDGES
from flexx2_sim_ros.batch.frame import (
    BORDER,
    Frame,
    Noise,
    of_listed,
    OPTIONS,
    Own,
    own_of,
    padded,
    Surfaces,
)
from flexx2_sim_ros.batch.kernels import add_to_list
from flexx2_sim_ros.formulas import pixels as pixel_formulas
from flexx2_sim_ros.physics import lateral
import warp as wp

wp.set_module_options(OPTIONS)

_WINDOW = wp.constant(lateral.WINDOW)
_STILL = wp.constant(wp.uint16(0))
# In `jumps`, besides the jump to the right and the one below: which of them is a displaced edge.
_EDGES = wp.constant(12)
_COLUMN_EDGE = wp.constant(8)

_is_upright = compiled(pixel_formulas.is_upright)
_is_apart = compiled(pixel_formulas.is_apart)
_passed_pixel = compiled(pixel_formulas.passed_pixel)
_pixels_moved = compiled(pixel_formulas.pixels_moved)
_source_of = compiled(pixel_formulas.source_of)


@wp.func
def is_upright(s: Surfaces, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.bool:
    """Say whether the edge at a pixel with a jump runs nearer to vertical, or diagonally."""
    across = wp.int32(0)
    down = wp.int32(0)
    yy = wp.max(y - _WINDOW, 0)
    while yy < wp.min(y + _WINDOW + 1, s.lens.height):
        row = padded(s.lens, n, yy, 0)
        xx = wp.max(x - _WINDOW, 0)
        while xx < wp.min(x + _WINDOW + 1, s.lens.width):
            jump = wp.int32(at_byte(s.jumps, row + xx))
            across += jump & 1
            down += (jump >> 1) & 1
            xx += 1
        yy += 1
    return _is_upright(across, down)


@wp.func
def displace(
    f: Frame,
    n: wp.int32,
    along: wp.int32,
    shift: wp.int32,
    last: wp.int32,
    first: wp.int32,
    pitch: wp.int32,
    column: wp.int32,
    lists: wp.bool,
):
    """
    Displace one edge, between positions ``along`` and ``along + 1`` of a line of pixels.

    The nearest displaced edge wins: ``moved`` holds its distance, the direction of its line and
    from where along it the pixel takes its value, 0 for no edge. The least of these is right in
    any order: as near, rows win over columns, and edges from the left or above over others.
    """
    step = wp.int32(1)
    while step <= wp.abs(shift):
        position = _passed_pixel(along, step, shift)
        if position < 0 or position > last:
            break
        pixel = first + position * pitch
        offset = _source_of(position, shift, last) - position
        code = wp.uint16((step << 9) | (column << 8) | (offset + 128))
        if put_least(f.moved, pixel, code) == _STILL and lists:
            add_to_list(f, n, pixel - n * f.lens.height * f.lens.width, 1, 1, 1)
        step += 1


@wp.func
def edge_shift(
    noise: Noise, key: wp.vec2ui, stamp: wp.int64, index: wp.int32, column: wp.int32
) -> wp.int32:
    """Return by how many pixels the edge of a row, or (``column`` 1) of a column, moves."""
    stream = wp.where(column == 1, COLUMN_EDGES, ROW_EDGES)
    draw = edge_draw(counter_of(index, stream, stamp), key, noise.edge_laplace)
    return _pixels_moved(draw, noise.edge_sigma, noise.edge_limit)


@wp.kernel
def move_edges(f: Frame, column: wp.int32):
    """Displace the edges of one row, or (``column`` 1) of one column. For the CPU."""
    n, line = wp.tid()
    own = own_of(f, n)
    if own.noise.edge_sigma <= 0.0:
        return
    width = f.lens.width
    pitch = wp.where(column == 1, width + BORDER, 1)
    start = wp.where(column == 1, padded(f.lens, n, 0, line), padded(f.lens, n, line, 0))
    first = n * f.lens.height * width + wp.where(column == 1, line, line * width)
    end = wp.where(column == 1, f.lens.height, width) - 1
    flag = wp.where(column == 1, 2, 1)
    last_edge = -1 - f.lens.neighbourhood
    shift = wp.int32(0)
    along = wp.int32(0)
    while along < end:
        if (wp.int32(at_byte(f.surfaces.jumps, start + along * pitch)) & flag) != 0:
            y = wp.where(column == 1, along, line)
            x = wp.where(column == 1, line, along)
            if is_upright(f.surfaces, n, y, x) == (column == 0):
                if _is_apart(along, last_edge, f.lens.neighbourhood):
                    shift = edge_shift(own.noise, own.key, own.stamp, y * width + x, column)
                last_edge = along
                step = wp.where(column == 1, width, 1)
                displace(f, n, along, shift, end, first, step, column, True)
        along += 1


@of_listed()
def mark_edges(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Mark which of the jumps of the listed pixels are edges of their row (4) or column (8)."""
    i = padded(f.lens, n, y, x)
    jumps = wp.int32(at_byte(f.surfaces.jumps, i)) & 3
    edge = wp.where(is_upright(f.surfaces, n, y, x), jumps & 1, jumps & 2)
    put_byte(f.surfaces.jumps, i, wp.uint8(jumps | (edge << 2)))


@wp.func
def _moves_edges(f: Frame, own: Own) -> wp.bool:
    return own.noise.edge_sigma > 0.0


@of_listed(when=_moves_edges)
def move_marked(f: Frame, own: Own, n: wp.int32, y: wp.int32, x: wp.int32):
    """Displace the marked edges, each on its own. For CUDA."""
    i = padded(f.lens, n, y, x)
    edge = wp.int32(at_byte(f.surfaces.jumps, i)) & _EDGES
    if edge != 0:
        column = wp.where(edge == _COLUMN_EDGE, 1, 0)
        pixel = y * f.lens.width + x
        pitch = wp.where(column == 1, f.lens.width, 1)
        border = wp.where(column == 1, f.lens.width + BORDER, 1)
        along = wp.where(column == 1, y, x)
        # The first of the edges that move as one.
        head = wp.int32(along)
        before = along - 1
        while before >= 0 and not _is_apart(head, before, f.lens.neighbourhood):
            if (wp.int32(at_byte(f.surfaces.jumps, i - (along - before) * border)) & edge) != 0:
                head = before
            before -= 1
        index = pixel - (along - head) * pitch
        shift = edge_shift(own.noise, own.key, own.stamp, index, column)
        end = wp.where(column == 1, f.lens.height, f.lens.width) - 1
        first = n * f.lens.height * f.lens.width + pixel - along * pitch
        displace(f, n, along, shift, end, first, pitch, column, False)

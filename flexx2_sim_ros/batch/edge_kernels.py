"""Lateral noise as Warp kernels: edges that jitter as a whole; see `physics.lateral`."""

from flexx2_sim_ros.batch.arithmetic import COLUMN_EDGES, counter_of, edge_draw, ROW_EDGES
from flexx2_sim_ros.batch.arrays import at_byte, put_byte, put_least
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.kernels import add_to_list, BORDER, Lens, Noise, OPTIONS, padded, SPREAD
from flexx2_sim_ros.formulas import edges
from flexx2_sim_ros.physics import lateral
import warp as wp

wp.set_module_options(OPTIONS)

_WINDOW = wp.constant(lateral.WINDOW)
_STILL = wp.constant(wp.uint16(0))
# In `jumps`, besides the jump to the right and the one below: which of them is a displaced edge.
_EDGES = wp.constant(12)
_COLUMN_EDGE = wp.constant(8)

_is_upright = compiled(edges.is_upright)
_is_apart = compiled(edges.is_apart)
_passed_pixel = compiled(edges.passed_pixel)
_pixels_moved = compiled(edges.pixels_moved)
_source_of = compiled(edges.source_of)


@wp.func
def is_upright(
    jumps: wp.array(dtype=wp.uint8), lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32
) -> wp.bool:
    """Say whether the edge at a pixel with a jump runs nearer to vertical, or diagonally."""
    across = wp.int32(0)
    down = wp.int32(0)
    yy = wp.max(y - _WINDOW, 0)
    while yy < wp.min(y + _WINDOW + 1, lens.height):
        row = padded(lens, n, yy, 0)
        xx = wp.max(x - _WINDOW, 0)
        while xx < wp.min(x + _WINDOW + 1, lens.width):
            jump = wp.int32(at_byte(jumps, row + xx))
            across += jump & 1
            down += (jump >> 1) & 1
            xx += 1
        yy += 1
    return _is_upright(across, down)


@wp.func
def displace(
    n: wp.int32,
    along: wp.int32,
    shift: wp.int32,
    last: wp.int32,
    first: wp.int32,
    pitch: wp.int32,
    column: wp.int32,
    lens: Lens,
    moved: wp.array(dtype=wp.uint16),
    lists: wp.bool,
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
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
        if put_least(moved, pixel, code) == _STILL and lists:
            add_to_list(lens, n, pixel - n * lens.height * lens.width, 1, 1, 1, listed, pixel_list)
        step += 1


@wp.func
def edge_shift(
    noise: Noise, index: wp.int32, stream: wp.uint32, stamp: wp.int64, key: wp.vec2ui
) -> wp.int32:
    """Return by how many pixels an edge moves."""
    draw = edge_draw(counter_of(index, stream, stamp), key, noise.edge_laplace)
    return _pixels_moved(draw, noise.edge_sigma, noise.edge_limit)


@wp.kernel
def move_edges(
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    column: wp.int32,
    noises: wp.array(dtype=Noise),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    moved: wp.array(dtype=wp.uint16),
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Displace the edges of one row, or (``column`` 1) of one column. For the CPU."""
    n, line = wp.tid()
    noise = noises[first + n]
    if noise.edge_sigma <= 0.0:
        return
    pixels = lens.height * lens.width
    pitch = wp.where(column == 1, lens.width + BORDER, 1)
    start = wp.where(column == 1, padded(lens, n, 0, line), padded(lens, n, line, 0))
    end = wp.where(column == 1, lens.height, lens.width) - 1
    flag = wp.where(column == 1, 2, 1)
    last_edge = -1 - lens.neighbourhood
    shift = wp.int32(0)
    at_line = wp.int32(0)
    while at_line < end:
        if (wp.int32(at_byte(jumps, start + at_line * pitch)) & flag) != 0:
            y = wp.where(column == 1, at_line, line)
            x = wp.where(column == 1, line, at_line)
            if is_upright(jumps, lens, n, y, x) == (column == 0):
                if _is_apart(at_line, last_edge, lens.neighbourhood):
                    shift = edge_shift(
                        noise,
                        y * lens.width + x,
                        wp.where(column == 1, COLUMN_EDGES, ROW_EDGES),
                        stamps[first + n],
                        keys[first + n],
                    )
                last_edge = at_line
                displace(
                    n,
                    at_line,
                    shift,
                    end,
                    n * pixels + wp.where(column == 1, line, line * lens.width),
                    wp.where(column == 1, lens.width, 1),
                    column,
                    lens,
                    moved,
                    True,
                    listed,
                    pixel_list,
                )
        at_line += 1


@wp.kernel
def mark_edges(
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    threads: wp.int32,
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Mark which of the jumps of the listed pixels are edges of their row (4) or column (8)."""
    n, thread = wp.tid()
    entry = wp.int32(thread)
    while entry < listed[n * SPREAD]:
        pixel = pixel_list[n * lens.height * lens.width + entry]
        y = pixel / lens.width
        x = pixel - y * lens.width
        i = padded(lens, n, y, x)
        own = wp.int32(at_byte(jumps, i)) & 3
        edge = wp.where(is_upright(jumps, lens, n, y, x), own & 1, own & 2)
        put_byte(jumps, i, wp.uint8(own | (edge << 2)))
        entry += threads


@wp.kernel
def move_marked(
    jumps: wp.array(dtype=wp.uint8),
    lens: Lens,
    first: wp.int32,
    threads: wp.int32,
    noises: wp.array(dtype=Noise),
    keys: wp.array(dtype=wp.vec2ui),
    stamps: wp.array(dtype=wp.int64),
    moved: wp.array(dtype=wp.uint16),
    listed: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Displace the marked edges, each on its own. For CUDA."""
    n, thread = wp.tid()
    noise = noises[first + n]
    pixels = lens.height * lens.width
    entry = wp.int32(thread)
    while entry < listed[n * SPREAD] and noise.edge_sigma > 0.0:
        pixel = pixel_list[n * pixels + entry]
        y = pixel / lens.width
        x = pixel - y * lens.width
        i = padded(lens, n, y, x)
        edge = wp.int32(at_byte(jumps, i)) & _EDGES
        if edge != 0:
            column = wp.where(edge == _COLUMN_EDGE, 1, 0)
            pitch = wp.where(column == 1, lens.width, 1)
            border = wp.where(column == 1, lens.width + BORDER, 1)
            along = wp.where(column == 1, y, x)
            # The first of the edges that move as one.
            head = wp.int32(along)
            before = along - 1
            while before >= 0 and not _is_apart(head, before, lens.neighbourhood):
                if (wp.int32(at_byte(jumps, i - (along - before) * border)) & edge) != 0:
                    head = before
                before -= 1
            shift = edge_shift(
                noise,
                pixel - (along - head) * pitch,
                wp.where(column == 1, COLUMN_EDGES, ROW_EDGES),
                stamps[first + n],
                keys[first + n],
            )
            displace(
                n,
                along,
                shift,
                wp.where(column == 1, lens.height, lens.width) - 1,
                n * pixels + pixel - along * pitch,
                pitch,
                column,
                lens,
                moved,
                False,
                listed,
                pixel_list,
            )
        entry += threads

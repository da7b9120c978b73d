"""Lateral noise as Warp kernels: edges that jitter as a whole; see `physics.lateral`."""

from flexx2_sim_ros.batch.arithmetic import COLUMN_EDGES, counter_of, edge_draw, ROW_EDGES
from flexx2_sim_ros.batch.arrays import at_byte, at_word, put_word
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.kernels import BORDER, Lens, Noise, OPTIONS, padded
from flexx2_sim_ros.formulas import edges
from flexx2_sim_ros.physics import lateral
import warp as wp

wp.set_module_options(OPTIONS)

_WINDOW = wp.constant(lateral.WINDOW)

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
            down += jump >> 1
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
    pixels: wp.int32,
    moved: wp.array(dtype=wp.uint16),
    moved_pixels: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """
    Displace one edge, between positions ``along`` and ``along + 1`` of a line of pixels.

    The nearest displaced edge wins: ``moved`` holds its distance, the direction of its line and
    from where along it the pixel takes its value, 0 for no edge.
    """
    step = wp.int32(1)
    while step <= wp.abs(shift):
        position = _passed_pixel(along, step, shift)
        if position < 0 or position > last:
            break
        pixel = first + position * pitch
        before = wp.int32(at_word(moved, pixel))
        if before == 0 or step < (before >> 9):
            offset = _source_of(position, shift, last) - position
            put_word(moved, pixel, wp.uint16((step << 9) | (column << 8) | (offset + 128)))
        if before == 0:
            place = wp.atomic_add(moved_pixels, n, 1)
            pixel_list[n * pixels + place] = pixel - n * pixels
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
    moved_pixels: wp.array(dtype=wp.int32),
    pixel_list: wp.array(dtype=wp.int32),
):
    """Displace the edges of one row, or (``column`` 1, after all rows) of one column."""
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
                    pixels,
                    moved,
                    moved_pixels,
                    pixel_list,
                )
        at_line += 1

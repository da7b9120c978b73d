"""
Lateral noise of edges as the base model defines it, implemented independently.

An edge moves by a Gaussian number of whole pixels: a rather vertical one along the row, a rather
horizontal one along the column. Edges of a row or column within eight pixels of the previous one
move together. Pixels between the old and the new place get the depth of the other side.
"""

import math

from flexx2_sim_ros.physics.compiled import loop
import numpy as np

_TOGETHER = 8
_WINDOW = 4


def edge_maps(row_jumps: np.ndarray, column_jumps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Sort depth jumps by the direction in which their edge moves.

    `row_jumps`, `column_jumps`: (H, W) uint8, 1 where depth jumps to the next pixel of the row, of
    the column. Returns (H, W) bool: jumps that move along the row, and along the column.
    """
    upright = _neighbours(row_jumps) + 1 >= _neighbours(column_jumps)
    return (row_jumps > 0) & upright, (column_jumps > 0) & ~upright


def _neighbours(flags: np.ndarray) -> np.ndarray:
    # Number of flags in the 9 x 9 window around each pixel.
    size = 2 * _WINDOW + 1
    total = np.pad(flags.astype(np.int32), _WINDOW).cumsum(0).cumsum(1)
    total = np.pad(total, ((1, 0), (1, 0)))
    return (
        total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]
    )


def jitter_edges(
    rows: np.ndarray,
    columns: np.ndarray,
    spread: float,
    scale: float,
    rng: np.random.Generator,
    tails: float = 0.0,
) -> np.ndarray:
    """
    Displace the edges of one frame.

    * `rows`, `columns`: (H, W) bool from `edge_maps`
    * `spread`: sigma_x of the mode, pixels, including the rounding to whole pixels
    * `scale`: factor on ``spread``
    * `rng`: draws one number for each row or column and edge
    * `tails`: fraction of the draws that are from Student's t with 3 degrees of freedom, scaled to
      unit variance. 0 gives Gaussian edges.

    Returns (H * W,) int32, the index of the pixel whose light each pixel gets.
    """
    source = np.arange(rows.size, dtype=np.int32)
    sigma = math.sqrt(max((spread * scale) ** 2 - 1 / 12, 0.0))
    reach = np.full(rows.shape, 1 << 20, np.int32)
    for lines, turned in ((rows, False), (columns, True)):
        count = int(lines.sum())
        draws = rng.standard_normal(count)
        if tails:
            heavy = rng.random(count) < tails
            draws[heavy] = rng.standard_t(3, int(heavy.sum())) / math.sqrt(3)
        shifts = np.clip(np.rint(sigma * draws), -40, 40).astype(np.int64)
        _sweep(lines, turned, shifts, reach, source)
    return source


@loop()
def _sweep(flags, turned, shifts, reach, source):
    height, width = flags.shape
    lines, length = (width, height) if turned else (height, width)
    draw = 0
    for line in range(lines):
        before, shift = -1000, 0
        for at in range(length - 1):
            if not (flags[at, line] if turned else flags[line, at]):
                continue
            if at - before > _TOGETHER:
                shift = shifts[draw]
                draw += 1
            before = at
            low, high = (at + 1, at + shift) if shift > 0 else (at + shift + 1, at)
            for place in range(max(low, 0), min(high, length - 1) + 1):
                # The nearest edge decides what a pixel sees.
                far = place - at if shift > 0 else at + 1 - place
                y, x = (place, line) if turned else (line, place)
                if far < reach[y, x]:
                    reach[y, x] = far
                    come = min(max(place - shift, 0), length - 1)
                    source[y * width + x] = come * width + line if turned else line * width + come

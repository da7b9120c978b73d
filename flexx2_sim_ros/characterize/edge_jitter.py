"""Lateral noise by the paper's procedure: how far a board's upright edge jumps, in pixels."""

from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.board_finding import Board, MARGIN_SHARE, SMALLEST_MARGIN
from flexx2_sim_ros.characterize.plane import straighten
from flexx2_sim_ros.characterize.tiles import kl_floor
from flexx2_sim_ros.physics.compiled import loop
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

_FEWEST_ROWS = 12
_STEEPEST_TILT = math.tan(math.radians(20))  # from upright
_STRAIGHT_PX = 1.5  # how far an outline may stray from a line, root mean square
_BEYOND = 3  # pixels: where the board, if it went on behind its edge, would have depth, too
_HALF_WINDOW = 14 / 224  # of the image's width: how far from the edge it is looked for
_STILL_PX = 0.01
_WHOLE_PIXEL = 1.0 / 12.0  # variance that rounding to whole pixels has by itself, px^2


@dataclass(frozen=True)
class EdgeSite:
    """
    Where an upright edge of the board is, ``left`` or ``right``, in R rows.

    Attributes
    ----------
    method : str
        ``gradient``, as in the paper; ``outline`` where nothing valid is behind the board, so
        that there is no gradient: the end of the valid pixels is taken.
    rows, first, last : numpy.ndarray
        (R,) rows to look at, and columns of each to look at, both inside.
    places, shift : numpy.ndarray
        (R,) where a lens that does not distort would have the row, and how much further right the
        edge in it, pixels.

    """

    side: str
    method: str
    rows: np.ndarray
    first: np.ndarray
    last: np.ndarray
    places: np.ndarray
    shift: np.ndarray


@dataclass(frozen=True)
class Edge:
    """
    What the frames say of an edge.

    Attributes
    ----------
    side, method : str
        As in `EdgeSite`.
    rows, frames : int
        How many were measured.
    sigma : float
        Standard deviation of the residuals from each frame's line, pixels.
    error : float
        Its standard error, if edge pixels are independent.
    kurtosis : float
        Excess kurtosis of the residuals; 0 for a Gaussian.
    variance, mean_square, log_variance, floor : float
        Means over rows, for `gaussian_kl`; NaN for a single frame.

    """

    side: str
    method: str
    rows: int
    frames: int
    sigma: float
    error: float
    kurtosis: float
    variance: float
    mean_square: float
    log_variance: float
    floor: float


def find_edges(
    board: Board,
    depth: np.ndarray,
    nearest: float = 0.0,
    farthest: float = math.inf,
    left_in: np.ndarray | None = None,
) -> list[EdgeSite]:
    """
    Find the upright edges of a board, left and right, at most two.

    ``depth`` is the image it was found in, (H, W) metres, NaN where invalid. A board that is cut
    off by the mode's range (``nearest``, ``farthest``) has no edge there. ``left_in`` (H, W) bool
    is False where a mask excludes the pixel: its border is no edge either. An edge so near to the
    image's border that it might leave it is none.
    """
    height, width = depth.shape
    half = max(4, round(_HALF_WINDOW * width))
    margin = max(SMALLEST_MARGIN, round(MARGIN_SHARE * width))
    rows = np.flatnonzero(board.mask.any(axis=1))
    extent = board.mask.sum(axis=1)
    plane = board.plane.depth(*np.indices(depth.shape)[::-1])
    possible = (plane > nearest) & (plane < farthest) & (True if left_in is None else left_in)
    sites = []
    for side in ('left', 'right'):
        outline = (
            board.mask.argmax(axis=1)
            if side == 'left'
            else width - 1 - board.mask[:, ::-1].argmax(axis=1)
        )[rows]
        line = _line(rows, outline, board.plane.lens)
        if line is None:
            continue
        # The board's corners are no edges: stay away from its upper and lower end.
        low = line[0][0] + (margin if line[0][0] > 0 else 0)
        high = line[0][-1] - (margin if line[0][-1] < height - 1 else 0)
        beyond = line[1] + (_BEYOND if side == 'right' else -_BEYOND)
        chosen = (line[0] >= low) & (line[0] <= high)
        for column in (line[1], beyond):
            chosen &= possible[line[0], np.clip(column, 0, width - 1)]
        kept, columns, places, shift = (part[chosen] for part in line)
        if len(kept) < _FEWEST_ROWS:
            continue
        inwards, outwards = int(min(half, extent[kept].min() // 2)), half
        first, last = (
            (columns - outwards, columns + inwards)
            if side == 'left'
            else (columns - inwards, columns + outwards)
        )
        if columns.min() < margin or columns.max() > width - 1 - margin:
            continue
        first, last = np.clip(first, 0, width - 1), np.clip(last, 0, width - 1)
        here, behind = _valid_shares(depth, side, kept, columns, first, last)
        # Where the board itself has holes, the end of its valid pixels is no edge.
        if behind > 0.8 or (behind < 0.05 and here > 0.98):
            method = 'gradient' if behind > 0.8 else 'outline'
            sites.append(EdgeSite(side, method, kept, first, last, places, shift))
    return sites


def _valid_shares(
    depth: np.ndarray,
    side: str,
    rows: np.ndarray,
    columns: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
) -> tuple[float, float]:
    """Return the share of valid pixels on the board next to an edge, and behind it."""
    before = (rows, first, columns - 2)
    after = (rows, columns + 3, last + 1)
    seen = [
        np.isfinite(
            np.concatenate([depth[row, start:end] for row, start, end in zip(*part, strict=True)])
        )
        for part in (before, after)
    ]
    shares = [float(part.mean()) if part.size else 0.5 for part in seen]
    return (shares[0], shares[1]) if side == 'right' else (shares[1], shares[0])


def _line(
    rows: np.ndarray, columns: np.ndarray, lens: Intrinsics | None
) -> tuple[np.ndarray, ...] | None:
    """Return the upright line through an outline, if it is one: as in `EdgeSite`."""
    straight, places = straighten(columns, rows, lens)
    shift = straight - columns
    near = np.isfinite(straight)
    for _ in range(3):
        rows, straight, places, shift = (part[near] for part in (rows, straight, places, shift))
        if len(rows) < _FEWEST_ROWS:
            return None
        tilt, start = np.polyfit(places, straight, 1)
        residual = straight - (tilt * places + start)
        near = np.abs(residual) <= max(3.0, 3.0 * float(np.median(np.abs(residual))))
    is_straight = float(np.sqrt(np.mean(residual[near] ** 2))) <= _STRAIGHT_PX
    if not is_straight or abs(tilt) > _STEEPEST_TILT or near.sum() < _FEWEST_ROWS:
        return None
    rows, places, shift = rows[near], places[near], shift[near]
    return rows, np.rint(tilt * places + start - shift).astype(np.int64), places, shift


def edge_positions(depth: np.ndarray, site: EdgeSite) -> np.ndarray:
    """
    Return the edge of each row and frame, (T, R) columns, half-way between pixels; NaN for none.

    By gradient: between the two successive valid pixels of the row that differ most (invalid ones
    left out). By outline: where valid pixels end. ``depth`` is (T, H, W) metres, NaN where
    invalid, taken as float32; columns are float64.
    """
    out = np.empty((len(depth), len(site.rows)))
    frames = np.ascontiguousarray(depth, np.float32)
    if site.method == 'gradient':
        _steepest(frames, site.rows, site.first, site.last, out)
    else:
        _outline(frames, site.rows, site.first, site.last, site.side == 'right', out)
    return out


@loop()
def _steepest(depth, rows, first, last, out):
    for t in range(depth.shape[0]):
        for i in range(rows.size):
            y = rows[i]
            before = -1
            largest = np.float32(-1.0)
            out[t, i] = np.nan
            for x in range(first[i], last[i] + 1):
                if depth[t, y, x] != depth[t, y, x]:
                    continue
                if before >= 0:
                    step = abs(depth[t, y, x] - depth[t, y, before])
                    if step > largest:
                        largest = step
                        out[t, i] = 0.5 * (x + before)
                before = x


@loop()
def _outline(depth, rows, first, last, right, out):
    # The end that the fewest pixels contradict: invalid ones on the board, valid ones beyond.
    for t in range(depth.shape[0]):
        for i in range(rows.size):
            y = rows[i]
            balance = 0
            best = 0
            out[t, i] = first[i] - 0.5
            for x in range(first[i], last[i] + 1):
                valid = depth[t, y, x] == depth[t, y, x]
                balance += 1 if valid == right else -1
                if balance > best:
                    best = balance
                    out[t, i] = x + 0.5
            if best == 0 or out[t, i] == last[i] + 0.5:
                out[t, i] = np.nan


def measure_edge(positions: np.ndarray, site: EdgeSite) -> Edge | None:
    """
    Fit a line to each frame's edge pixels and look at what is left.

    ``positions`` are (T, R) columns, NaN where a row has none; rows that miss more than a tenth of
    the frames are left out, then frames that miss one of the others. None when too little is left,
    or when the edge never moves: that is where an image was cropped.
    """
    rows = np.flatnonzero(np.isfinite(positions).mean(axis=0) > 0.9)
    edges = (positions + site.shift)[:, rows]
    edges = edges[np.isfinite(edges).all(axis=1)]
    frames, count = edges.shape
    if count < _FEWEST_ROWS or not frames:
        return None
    places = site.places[rows]
    design = np.stack([np.ones(count), places - places.mean()], axis=1)
    lines = np.linalg.lstsq(design, edges.T, rcond=None)[0]
    residual = (edges.T - design @ lines).T
    freedom = frames * (count - 2)
    variance = float((residual**2).sum() / freedom)
    if variance < _STILL_PX**2:
        return None
    fourth = float(np.mean(residual**4)) / float(np.mean(residual**2)) ** 2
    # A sample's standard deviation is surer than this the lighter its tails are.
    error = math.sqrt(variance * (fourth - 1) / (4 * freedom))
    rows_variance = rows_square = rows_log = floor = math.nan
    if frames > 1:
        grown = residual * math.sqrt(count / (count - 2))  # the line took two of its freedoms
        spread = np.maximum(grown.var(axis=0, ddof=1), _WHOLE_PIXEL)
        rows_variance, rows_log = float(spread.mean()), float(np.log(spread).mean())
        rows_square = float((grown.mean(axis=0) ** 2).mean())
        floor = float(kl_floor(frames))
    return Edge(
        site.side,
        site.method,
        count,
        frames,
        math.sqrt(variance),
        error,
        fourth - 3.0,
        rows_variance,
        rows_square,
        rows_log,
        floor,
    )


def edge_sigma(depth: np.ndarray, columns: slice) -> float:
    """
    Return sigma_x of an upright edge whose place is known, pixels; 0 if it does not move.

    ``depth`` is (T, H, W) metres, NaN where invalid; ``columns`` are those next to the edge, the
    same in all rows.
    """
    first, last, _ = columns.indices(depth.shape[2])
    rows = np.arange(depth.shape[1])
    site = EdgeSite(
        '',
        'gradient',
        rows,
        np.full_like(rows, first),
        np.full_like(rows, last - 1),
        rows.astype(np.float64),
        np.zeros(len(rows)),
    )
    edge = measure_edge(edge_positions(depth, site), site)
    return 0.0 if edge is None else edge.sigma

"""Read the frames of a recording once: find the board, and sum up what its measurement needs."""

from collections.abc import Iterator
from dataclasses import dataclass

from flexx2_sim_ros.characterize import board_finding as boards
from flexx2_sim_ros.characterize.amplitude import AmplitudeCounts, count_invalid
from flexx2_sim_ros.characterize.board_finding import Board, find_board
from flexx2_sim_ros.characterize.edge_jitter import (
    Edge,
    edge_positions,
    EdgeSite,
    find_edges,
    measure_edge,
)
from flexx2_sim_ros.characterize.moments import Accumulator
from flexx2_sim_ros.characterize.pixel_statistics import FrameMeans
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording import Recording, RecordingReader
from flexx2_sim_ros.recording.truth import read_truth
import numpy as np

_CHUNK = 60
_FIRST = 30  # frames in which the board is searched


@dataclass
class SinglePass:
    """
    Sums over the frames of a recording.

    Attributes
    ----------
    board : Board
        Found in the first frames.
    first : numpy.ndarray
        (H, W) median depth of these frames, metres; NaN where most are invalid.
    sites : list of EdgeSite
        Edges of the board.
    sums : Accumulator
        Sums of depth for each pixel.
    means : FrameMeans
        Mean error of each frame.
    left_in : numpy.ndarray
        (H, W) frames in which no mask excludes the pixel.
    positions : list of list of numpy.ndarray
        Positions of each edge, by chunks of frames.
    clean : numpy.ndarray or None
        (H, W) clean depth, metres.
    levels : numpy.ndarray
        (H, W) mean amplitude; 0 without amplitude images.
    counts : AmplitudeCounts or None
        Valid and invalid pixels by amplitude; None without amplitude images.

    """

    board: Board
    first: np.ndarray
    sites: list[EdgeSite]
    sums: Accumulator
    means: FrameMeans
    left_in: np.ndarray
    positions: list[list[np.ndarray]]
    clean: np.ndarray | None
    levels: np.ndarray
    counts: AmplitudeCounts | None = None

    def add(self, depth: np.ndarray, left_in: np.ndarray) -> None:
        """Add (n, H, W) consecutive frames: metres, NaN where invalid; bool, False if masked."""
        self.sums.add(depth)
        self.means.add(depth)
        self.left_in += left_in.sum(axis=0)
        for columns, site in zip(self.positions, self.sites, strict=True):
            columns.append(edge_positions(depth, site))

    def add_amplitude(
        self,
        amplitude: np.ndarray,
        depth: np.ndarray,
        left_in: np.ndarray,
        window: tuple[slice, slice],
        frames: int,
    ) -> None:
        """Add (n, H, W) amplitudes of a recording with this number of frames."""
        counted = np.where(left_in, amplitude, np.nan)[:, *window]
        found = count_invalid(counted, np.isfinite(depth[:, *window]))
        self.counts = found if self.counts is None else self.counts + found
        self.levels += amplitude.sum(axis=0) / frames

    def edges(self) -> tuple[Edge, ...]:
        """Return the lateral noise of each edge that can be measured."""
        edges = (
            measure_edge(np.concatenate(columns), site)
            for columns, site in zip(self.positions, self.sites, strict=True)
        )
        return tuple(edge for edge in edges if edge is not None)


def read_frames(
    reader: RecordingReader, box: tuple[int, int, int, int] | None, near: float, far: float
) -> SinglePass:
    """
    Read all frames of a recording once.

    ``box`` is x0, y0, x1, y1 of the board; None: search it. ``near`` and ``far`` are the range of
    the mode, metres. Raises InputError when there is no board, or depth is not in metres.
    """
    frames, height, width = reader.shape
    x0, y0, x1, y1 = box or (0, 0, width, height)
    window = slice(y0, y1), slice(x0, x1)
    seen: SinglePass | None = None
    for depth, left_in, part in masked_chunks(reader):
        if seen is None:
            seen = _start(reader, depth, left_in, part, box, near, far)
        seen.add(depth, left_in)
        if part.amplitude is not None:
            amplitude = np.broadcast_to(np.asarray(part.amplitude, np.float64), depth.shape)
            seen.add_amplitude(amplitude, depth, left_in, window, frames)
    assert seen is not None
    return seen


def masked_chunks(reader: RecordingReader) -> Iterator[tuple[np.ndarray, np.ndarray, Recording]]:
    """
    Read a recording without the pixels that a mask excludes.

    Masks are the recording's key `known` and the pixels that never have depth by the reader's
    profile. Yielded are (n, H, W) depth of some frames, metres, NaN where invalid or masked; (n,
    H, W) bool, False where masked; and the frames as they are.
    """
    known = read_truth(reader.path, reader.arrays, reader.shape).known
    _, height, width = reader.shape
    camera = Intrinsics.from_matrix(reader.K, width, height, reader.distortion)
    outside = reader.profile.sensor.outside(camera)
    start = 0
    for part in reader.chunks(_CHUNK):
        depth = only_valid(part.depth)
        left_in = np.ones(depth.shape, bool)
        if known is not None:
            left_in &= known if known.ndim == 2 else known[start : start + len(depth)]
            start += len(depth)
        if outside is not None:
            left_in &= ~outside
        if not left_in.all():
            depth = np.where(left_in, depth, np.float32(np.nan))
        yield depth, left_in, part


def _start(
    reader: RecordingReader,
    depth: np.ndarray,
    left_in: np.ndarray,
    part: Recording,
    box: tuple[int, int, int, int] | None,
    near: float,
    far: float,
) -> SinglePass:
    frames = reader.shape[0]
    first, noise = _typical(depth[:_FIRST])
    # One frame has no jumping edges yet.
    margin = boards.SMALLEST_MARGIN if frames == 1 else None
    board = find_board(first, noise, reader.K, box, margin, reader.distortion)
    # Where the box ends, the board may go on.
    inside = left_in.max(axis=0)
    if box is not None:
        x0, y0, x1, y1 = box
        window = np.zeros_like(inside)
        window[y0:y1, x0:x1] = True
        inside = inside & window
    # In a single frame, the outline of valid pixels may only be where the image was cropped.
    sites = [
        site
        for site in find_edges(board, first, near, far, inside)
        if frames > 1 or site.method == 'gradient'
    ]
    plane = board.plane.depth(*np.indices(first.shape)[::-1])
    # Sums far from the plane are not used, but must stay finite.
    reference = np.where(np.isfinite(first), first, np.nan_to_num(plane, nan=0.0))
    return SinglePass(
        board,
        first,
        sites,
        Accumulator(reference),
        FrameMeans(board.region, reference),
        np.zeros(first.shape, np.int64),
        [[] for _ in sites],
        None if part.clean_depth is None else _clean(part.clean_depth),
        np.zeros(first.shape),
    )


def only_valid(depth: np.ndarray) -> np.ndarray:
    """Return depth with NaN in place of all values that are not positive and finite."""
    # Usually there are none besides NaN, and this test is faster than a copy.
    if np.fmin.reduce(depth, axis=None) > 0 and np.fmax.reduce(depth, axis=None) < np.inf:
        return depth
    with np.errstate(invalid='ignore'):
        return np.where((depth > 0) & (depth < np.inf), depth, np.float32(np.nan))


def _typical(depth: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the median over frames (NaN where most are invalid) and its standard deviation."""
    count = np.isfinite(depth).sum(axis=0)
    if not count.any():
        raise InputError('depth: must have a board in view, got only invalid pixels')
    ordered = np.sort(depth, axis=0)  # NaN last
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
    typical = np.where(2 * count >= len(depth), middle, np.nan).astype(np.float64)
    if len(depth) > 1:
        step = np.diff(depth[:, ::2, ::2], axis=0)
        noise = 1.25 * np.sqrt(0.5 * np.nanmedian(step**2) / 0.455 / len(depth))
    else:
        # The median square of a standard normal is 0.455; a slope is the same everywhere.
        step = np.diff(typical, axis=1)
        noise = np.sqrt(0.5 * np.nanmedian((step - np.nanmedian(step)) ** 2) / 0.455)
    return typical, float(np.nan_to_num(noise))


def _clean(clean: np.ndarray) -> np.ndarray:
    # One image: the first that is there, because a bag may lack that of a frame.
    if clean.ndim == 3:
        clean = next((image for image in clean if np.isfinite(image).any()), clean[0])
    return np.asarray(clean, np.float64)

"""Measure one recording: find the board, go through the frames once, keep a small summary."""

from dataclasses import dataclass
import math
from pathlib import Path

from flexx2_sim_ros.characterize import board as boards
from flexx2_sim_ros.characterize.amplitude import AmplitudeCounts, count_invalid
from flexx2_sim_ros.characterize.board import Board, find_board
from flexx2_sim_ros.characterize.conditions import Condition, parse_name
from flexx2_sim_ros.characterize.lateral import Edge, edge_positions, find_edges, measure_edge
from flexx2_sim_ros.characterize.moments import Accumulator, Moments
from flexx2_sim_ros.characterize.pixels import FrameMeans, pixel_statistics, Pixels
from flexx2_sim_ros.characterize.plane import fit_plane, Plane
from flexx2_sim_ros.characterize.tiles import SPATIAL_SIDE, spatial_tiles, temporal_tiles, Tiles
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import flexx2, Profile
from flexx2_sim_ros.recording import open_recording, RecordingReader
from flexx2_sim_ros.recording.truth import read_truth
import numpy as np

_CHUNK = 60
_FIRST = 30  # frames that the board is looked for in
_VALID_SHARE = 0.5  # of the frames: a pixel with fewer is left out
_CUT_OFF = 5.0  # standard deviations: nearer to the range's end, noise is cut off
_FAR = 100.0  # metres: no depth camera of this kind sees that far
_TAPE = (0.05, 0.10)  # how far (metres, share) the board may be from where its name says
_PROTRACTOR = 8.0  # degrees
_WINDOW = (66 / 224, 51 / 172)  # of the image: the paper's 1,009,800 samples in 300 frames at 1 m


@dataclass(frozen=True)
class Measurement:
    """
    What one recording says.

    Attributes
    ----------
    path : pathlib.Path
        The recording.
    usecase : str
        The mode: the recording's own, else that of its name, else ``unknown``.
    condition : Condition or None
        What the name states.
    frames : int
        Frames.
    size : tuple of int
        Width and height.
    K : numpy.ndarray
        (3, 3) camera matrix.
    distortion : tuple of float
        Of the lens; zeros where the recording has none.
    rate_hz : float
        Frames a second; NaN for a single frame.
    distance, angle_deg : float
        Of the plane, at the region's pixel nearest to the optical axis.
    plane : Plane
        The board's.
    window : tuple of int
        x0, y0, x1, y1 of a rectangle about that pixel, on the board, no larger than the paper's
        region was at 1 m.
    bias : float
        Measured less true depth, metres; NaN where the truth is not known.
    bias_of : str
        What the truth is: ``clean depth``, ``tape`` or nothing.
    pixels : Pixels
        What its region's pixels are like.
    tiles : Tiles
        Noise in small tiles.
    edges : tuple of Edge
        Lateral noise at each edge that was found.
    amplitude : AmplitudeCounts or None
        Validity against amplitude.
    notes : tuple of str
        What a person should know.

    """

    path: Path
    usecase: str
    condition: Condition | None
    frames: int
    size: tuple[int, int]
    K: np.ndarray  # noqa: N815
    distortion: tuple[float, ...]
    rate_hz: float
    distance: float
    angle_deg: float
    plane: Plane
    window: tuple[int, int, int, int]
    bias: float
    bias_of: str
    pixels: Pixels
    tiles: Tiles
    edges: tuple[Edge, ...]
    amplitude: AmplitudeCounts | None
    notes: tuple[str, ...]

    @property
    def spatial(self) -> bool:
        """Whether noise is what one frame leaves of a plane, for want of more frames."""
        return self.frames == 1

    @property
    def reflectivity(self) -> float:
        """Return the board's reflectivity, 0..1, by its name; 1 where that does not say."""
        return 1.0 if self.condition is None else self.condition.reflectivity

    @property
    def label(self) -> tuple[float, float]:
        """Return distance and angle by which a person knows the recording."""
        if self.condition is not None:
            return self.condition.distance, self.condition.angle_deg
        return round(self.distance, 2), round(self.angle_deg, 1)


def measure(
    path: Path,
    box: tuple[int, int, int, int] | None = None,
    camera: str | None = None,
    profile: Profile | None = None,
) -> Measurement:
    """
    Measure a recording.

    Parameters
    ----------
    path : pathlib.Path
        A recording (``.npz`` or bag).
    box : tuple of int, optional
        x0, y0, x1, y1 of the region; found when left out.
    camera : str, optional
        Which camera of a bag that has several.
    profile : Profile, optional
        The camera whose modes say range and rate; the Flexx2 when left out.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError
        When it cannot be read or measured; the message names the file and what was expected.

    """
    profile = profile or flexx2()
    reader = open_recording(path, camera, profile)
    try:
        return _measure(reader, parse_name(Path(path)), box, profile)
    except InputError as error:
        text = str(error)
        raise InputError(text if str(path) in text else f'{path}: {text}') from error


def _measure(
    reader: RecordingReader,
    condition: Condition | None,
    box: tuple[int, int, int, int] | None,
    profile: Profile,
) -> Measurement:
    usecase = _usecase(reader, condition)
    near, far = _range(profile, usecase)
    frames, height, width = reader.shape
    if box is not None and not (0 <= box[0] < box[2] <= width and 0 <= box[1] < box[3] <= height):
        raise InputError(f'box: must be x0 y0 x1 y1 within {width} x {height}, got {box}')
    x0, y0, x1, y1 = box or (0, 0, width, height)
    window = slice(y0, y1), slice(x0, x1)
    board: Board | None = None
    known = read_truth(reader.path, reader.arrays, reader.shape).known
    start = 0
    for part in reader.chunks(_CHUNK):
        depth = only_valid(part.depth)
        if known is not None:
            here = known if known.ndim == 2 else known[start : start + len(depth)]
            depth = np.where(here, depth, np.float32(np.nan))
            start += len(depth)
        if board is None:
            first, noise = _typical(depth[:_FIRST])
            _check_units(first, far)
            # One frame has no jumping edges yet.
            margin = boards.SMALLEST_MARGIN if frames == 1 else None
            board = find_board(first, noise, reader.K, box, margin, reader.distortion)
            # The outline of valid pixels in one frame may be no more than where it was cropped.
            sites = [
                site
                for site in find_edges(board, first, near, far)
                if frames > 1 or site.method == 'gradient'
            ]
            plane = board.plane.depth(*np.indices(first.shape)[::-1])
            # Far from any sight of the plane the sums are of no use, but must stay finite.
            reference = np.where(np.isfinite(first), first, np.nan_to_num(plane, nan=0.0))
            sums = Accumulator(reference)
            means = FrameMeans(board.region, reference)
            positions: list[list[np.ndarray]] = [[] for _ in sites]
            counts: AmplitudeCounts | None = None
            levels = np.zeros(first.shape)
            clean = None if part.clean_depth is None else _image(part.clean_depth)
        sums.add(depth)
        means.add(depth)
        for columns, site in zip(positions, sites, strict=True):
            columns.append(edge_positions(depth, site))
        if part.amplitude is not None:
            amplitude = np.broadcast_to(np.asarray(part.amplitude, np.float64), depth.shape)
            found = count_invalid(amplitude[:, *window], np.isfinite(depth[:, *window]))
            counts = found if counts is None else counts + found
            levels += amplitude.sum(axis=0) / frames
    assert board is not None
    moments = sums.moments()
    board, usable = _settle(board, moments, near, far)
    tiles = (
        spatial_tiles(board, first, levels if counts is not None else None)
        if frames == 1
        else temporal_tiles(board, moments, levels if counts is not None else None, usable)
    )
    if not len(tiles):
        raise InputError(
            f'board: must be plain, and near enough for {SPATIAL_SIDE} x {SPATIAL_SIDE} valid '
            'pixels of one amplitude, got none'
        )
    u, v = board.aim
    distance = float(board.plane.depth(u, v))
    angle = math.degrees(float(board.plane.incidence(u, v, reader.K)))
    _check_place(condition, distance, angle)
    bias, bias_of = _bias(board, moments, usable, clean, condition, distance)
    edges = (
        measure_edge(np.concatenate(columns), site)
        for columns, site in zip(positions, sites, strict=True)
    )
    return Measurement(
        reader.path,
        usecase,
        condition,
        frames,
        (width, height),
        reader.K,
        reader.distortion,
        _rate(reader),
        distance,
        angle,
        board.plane,
        _window(board),
        bias,
        bias_of,
        pixel_statistics(board, moments, usable, means),
        tiles,
        tuple(edge for edge in edges if edge is not None),
        counts,
        tuple(reader.notes),
    )


def _usecase(reader: RecordingReader, condition: Condition | None) -> str:
    stated = condition.usecase if condition is not None else None
    own = reader.usecase
    if own is not None and stated is not None and own.lower() != stated.lower():
        raise InputError(f'{reader.path}: usecase: must be {stated}, as the name says, got {own}')
    return own or stated or 'unknown'


def _range(profile: Profile, usecase: str) -> tuple[float, float]:
    try:
        mode = profile.mode(usecase)
    except InputError:
        return 0.0, math.inf
    return mode.range_min, mode.range_max


def only_valid(depth: np.ndarray) -> np.ndarray:
    """Return depth with NaN for whatever is no positive finite number."""
    # Mostly there is none but NaN, which is found out faster than a copy is made.
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


def _check_units(typical: np.ndarray, far: float) -> None:
    middle = float(np.nanmedian(typical))
    if middle > min(_FAR, 3 * far):
        raise InputError(
            f'depth: must be metres{"" if math.isinf(far) else f" up to {far:g}"}, got a '
            f'median of {middle:.4g}; are these millimetres?'
        )


def _check_place(condition: Condition | None, distance: float, angle: float) -> None:
    if condition is None:
        return
    allowed = _TAPE[0] + _TAPE[1] * condition.distance
    if abs(distance - condition.distance) > allowed:
        raise InputError(
            f'board: must be at {condition.distance:g} m, as the name says, within '
            f'{allowed:.2f} m, got {distance:.3f} m'
        )
    if abs(angle - condition.angle_deg) > _PROTRACTOR:
        raise InputError(
            f'board: must be at {condition.angle_deg:g} degrees, as the name says, within '
            f'{_PROTRACTOR:g}, got {angle:.1f}'
        )


def _image(clean: np.ndarray) -> np.ndarray:
    return np.asarray(clean[0] if clean.ndim == 3 else clean, np.float64)


def _settle(board: Board, moments: Moments, near: float, far: float) -> tuple[Board, np.ndarray]:
    """Fit the plane again, to all frames; say which pixels can be used."""
    enough = moments.count >= max(1.0, _VALID_SHARE * moments.frames)
    spread = np.sqrt(np.nan_to_num(moments.variance))
    with np.errstate(invalid='ignore'):
        whole = (moments.mean - _CUT_OFF * spread > near) & (
            moments.mean + _CUT_OFF * spread < far
        )
    usable = enough & whole
    v, u = np.nonzero(board.region & usable)
    least = boards.smallest_region(board.mask.shape)
    if len(u) < least:
        raise InputError(
            f'board: must have at least {least} pixels that are valid in half of '
            f"the frames and inside the mode's range by {_CUT_OFF:g} standard deviations, got "
            f'{len(u)} of {int(board.region.sum())}'
        )
    plane = fit_plane(u, v, moments.mean[v, u], board.plane.lens)
    return Board(plane, board.mask, board.region, board.K), usable


def _bias(
    board: Board,
    moments: Moments,
    usable: np.ndarray,
    clean: np.ndarray | None,
    condition: Condition | None,
    distance: float,
) -> tuple[float, str]:
    if clean is not None:
        with np.errstate(invalid='ignore'):
            error = (moments.mean - clean)[board.region & usable & (clean > 0)]
        if np.isfinite(error).any():
            return float(np.nanmean(error)), 'clean depth'
    if condition is not None:
        return distance - condition.distance, 'tape'
    return math.nan, ''


def _window(board: Board) -> tuple[int, int, int, int]:
    u, v = (round(place) for place in board.aim)
    height, width = board.mask.shape
    half_width, half_height = (
        max(1, round(share * size / 2))
        for share, size in zip(_WINDOW, (width, height), strict=True)
    )
    while True:
        box = (
            max(u - half_width, 0),
            max(v - half_height, 0),
            min(u + half_width, width),
            min(v + half_height, height),
        )
        inside = board.region[box[1] : box[3], box[0] : box[2]].mean()
        if inside > 0.99 or max(half_width, half_height) <= 1:
            return box
        half_width, half_height = max(1, half_width * 9 // 10), max(1, half_height * 9 // 10)


def _rate(reader: RecordingReader) -> float:
    steps = np.diff(reader.stamp)
    middle = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / middle if middle > 0 else math.nan

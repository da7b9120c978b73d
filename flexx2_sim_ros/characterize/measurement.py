"""Measure one recording: noise, bias and edges of the board in it."""

from dataclasses import dataclass
import math
from pathlib import Path

from flexx2_sim_ros.characterize import board_finding as boards
from flexx2_sim_ros.characterize.amplitude import AmplitudeCounts
from flexx2_sim_ros.characterize.board_finding import Board
from flexx2_sim_ros.characterize.conditions import Condition, parse_name
from flexx2_sim_ros.characterize.edge_jitter import Edge
from flexx2_sim_ros.characterize.moments import Moments
from flexx2_sim_ros.characterize.pixel_statistics import pixel_statistics, Pixels
from flexx2_sim_ros.characterize.plane import fit_plane, Plane
from flexx2_sim_ros.characterize.single_pass import read_frames
from flexx2_sim_ros.characterize.tiles import SPATIAL_SIDE, spatial_tiles, temporal_tiles, Tiles
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import flexx2, Profile
from flexx2_sim_ros.recording import open_recording, RecordingReader
import numpy as np

_VALID_SHARE = 0.5  # of the frames: a pixel with fewer is left out
_CUT_OFF = 5.0  # standard deviations: nearer to the range's end, noise is cut off
_TAPE = (0.05, 0.10)  # how far (metres, share) the board may be from where its name says
_PROTRACTOR = 8.0  # degrees
_WINDOW = (66 / 224, 51 / 172)  # of the image: the paper's 1,009,800 samples in 300 frames at 1 m


@dataclass(frozen=True)
class Measurement:
    """
    The measurement of one recording.

    Attributes
    ----------
    usecase : str
        The mode of the recording, else the mode in its name, else ``unknown``; a mode of the
        camera as the camera's profile writes it.
    condition : Condition or None
        Mode, distance and angle in the name.
    frames : int
        How many.
    size : tuple of int
        Width and height.
    K : numpy.ndarray
        (3, 3) camera matrix.
    distortion : tuple of float
        Distortion of the lens; zeros if the recording has none.
    rate_hz : float
        Frames per second; NaN for a single frame, and without stamps that rise.
    distance, angle_deg : float
        Distance and angle of the plane, at the pixel of the region that is nearest to the optical
        axis.
    window : tuple of int
        x0, y0, x1, y1 of a rectangle about that pixel, on the board, no larger than the paper's
        region was at 1 m.
    bias : float
        Measured minus true depth, metres; NaN if the true depth is unknown.
    bias_of : str
        Source of the true depth: ``clean depth``, ``tape`` or empty.
    pixels : Pixels
        Statistics of the pixels of the region.
    tiles : Tiles
        Noise in small tiles.
    edges : tuple of Edge
        Lateral noise of each edge that was found.
    amplitude : AmplitudeCounts or None
        Validity against amplitude.
    notes : tuple of str
        For people.

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
        """Whether noise is the deviation of a single frame from planes."""
        return self.frames == 1

    @property
    def reflectivity(self) -> float:
        """Return the reflectivity of the board, 0 to 1, from the name; 1 if the name has none."""
        return 1.0 if self.condition is None else self.condition.reflectivity

    @property
    def label(self) -> tuple[float, float]:
        """Return distance and angle for tables: those of the name, else rounded measured ones."""
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
    Measure a recording (``.npz`` or bag).

    ``box`` is x0, y0, x1, y1 of the region (default: detected), ``camera`` which one of a bag that
    has several, ``profile`` gives range and rate of its modes (default: the Flexx2). Raises
    InputError when the recording cannot be read or measured; the message names the file and what
    was expected.
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
    near, far = 0.0, math.inf
    if usecase.strip().lower() in map(str.lower, profile.names):
        mode = profile.mode(usecase)
        usecase, near, far = mode.name, mode.range_min, mode.range_max
    frames, height, width = reader.shape
    if box is not None and not (0 <= box[0] < box[2] <= width and 0 <= box[1] < box[3] <= height):
        raise InputError(f'box: must be x0 y0 x1 y1 within {width} x {height}, got {box}')
    seen = read_frames(reader, box, near, far)
    moments = seen.sums.moments()
    board, usable = _settle(seen.board, moments, near, far)
    levels = seen.levels if seen.counts is not None else None
    if frames == 1:
        tiles = spatial_tiles(board, seen.first, levels)
    else:
        tiles = temporal_tiles(board, moments, levels, usable)
    if len(tiles) and not tiles.variance.any():
        raise InputError(
            f'depth: must change from frame to frame, got {frames} times the same frame'
            if frames > 1
            else 'depth: must have noise, got planes'
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
    bias, bias_of = _bias(board, moments, usable, seen.clean, condition, distance)
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
        pixel_statistics(board, moments, usable, seen.means, seen.left_in),
        tiles,
        seen.edges(),
        seen.counts,
        tuple(reader.notes),
    )


def _usecase(reader: RecordingReader, condition: Condition | None) -> str:
    stated = condition.usecase if condition is not None else None
    own = reader.usecase
    if own is not None and stated is not None and own.lower() != stated.lower():
        raise InputError(f'{reader.path}: usecase: must be {stated}, as the name says, got {own}')
    return own or stated or 'unknown'


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


def _settle(board: Board, moments: Moments, near: float, far: float) -> tuple[Board, np.ndarray]:
    """Fit the plane again, to all frames; say which pixels can be used."""
    # One depth of several frames has no variance.
    enough = moments.count >= max(min(2, moments.frames), _VALID_SHARE * moments.frames)
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
    if reader.assumed_stamps:
        return math.nan
    steps = np.diff(reader.stamp)
    middle = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / middle if middle > 0 else math.nan

"""Boards that people own: chessboards, ChArUco boards and Kalibr's grids of AprilTags."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
import math
from pathlib import Path
from typing import Any

import cv2
from flexx2_sim_ros.config_file import read_mapping
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.truth.target import find_markers, read_target, Target
import numpy as np

_FINER = 4  # pixels of a drawing in one of the picture that is asked for. ASSUMED
_MOST_SQUARES, _LEAST, _LARGEST = 50, 0.002, 1.0  # metres. ASSUMED
# The bits of the first tag of AprilTag 36h11, its first row. DEFINITION
_FIRST_ROW = [1, 1, 0, 1, 0, 1]
_FORMS = 'chessboard:9x6:0.03 (inner corners, metres) or charuco:5x7:0.04:0.03:DICT_5X5_100'


@dataclass(frozen=True)
class Printed:
    """
    A board of rows of equal cells, drawn at any size.

    Attributes
    ----------
    columns, rows : int
        Numbers of squares, or of tags.
    square : float
        Side of a square, or of a tag with its black border, metres.
    white, flatness, scale_error : float
        As of `Target`.

    """

    columns: int
    rows: int
    square: float
    white: float = 0.8
    flatness: float = 0.001
    scale_error: float = 0.001

    turns = 1  # of so many turns about its middle it looks the same to the detector

    @property
    def kinds(self) -> 'tuple[Printed, ...]':
        """Return the boards that the description may mean."""
        return (self,)

    @property
    def width(self) -> float:
        """Return the size across, metres."""
        return self.columns * self.square

    @property
    def height(self) -> float:
        """Return the size down, metres."""
        return self.rows * self.square

    def corners(self) -> np.ndarray:
        """Return (N, C, 3) points that `find` finds, metres."""
        raise NotImplementedError

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Return (C, 2) points in an image, pixels, by their place in `corners`."""
        raise NotImplementedError

    def draw(self, pixels: int) -> np.ndarray:
        """Return an image of the board with so many pixels in a square; 255 for white."""
        raise NotImplementedError

    def paint(self, step: float) -> np.ndarray:
        """Draw the board as an image; see `Target.paint`."""
        size = [max(round(side / step), 1) for side in (self.width, self.height)]
        fine = self.draw(math.ceil(_FINER * self.square / step))
        return cv2.resize(fine, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255


@dataclass(frozen=True)
class Chessboard(Printed):
    """
    A chessboard; nothing is known of the paper around its squares.

    Attributes
    ----------
    first : str
        Colour of the upper left square.

    """

    first: str = 'black'

    @property
    def kinds(self) -> 'tuple[Printed, ...]':
        """Return this board, and the one of other colours where no turn makes it of this one."""
        even = (self.columns + self.rows) % 2 == 0 and self.columns != self.rows
        return (self, replace(self, first='white')) if even else (self,)

    @property
    def turns(self) -> int:  # type: ignore[override]
        """Return how often it looks the same in a turn."""
        return 4 if self.columns == self.rows else 2

    def corners(self) -> np.ndarray:
        """Return (1, N, 3): the inner corners."""
        across, down = (
            (np.arange(1, count) - count / 2) * self.square for count in (self.columns, self.rows)
        )
        x, y = np.meshgrid(across, down)
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)[None]

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Return the inner corners, all or none."""
        size = self.columns - 1, self.rows - 1
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        found, points = cv2.findChessboardCornersSB(picture, size, flags=flags)
        return {0: points.reshape(-1, 2)} if found else {}

    def draw(self, pixels: int) -> np.ndarray:
        """Draw its squares."""
        cells = np.add.outer(np.arange(self.rows), np.arange(self.columns)) % 2
        if self.first == 'white':
            cells = 1 - cells
        return np.kron(cells, np.full((pixels, pixels), 255)).astype(np.uint8)


@dataclass(frozen=True)
class Charuco(Printed):
    """
    OpenCV's chessboard with markers in its white squares.

    Attributes
    ----------
    marker : float
        Side of a marker, metres.
    dictionary : str
        As OpenCV names it.

    """

    marker: float = 0.02
    dictionary: str = 'DICT_5X5_100'

    @cached_property
    def _board(self) -> Any:
        codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, codes)

    def corners(self) -> np.ndarray:
        """Return (N, 4, 3) corners of the markers."""
        middle = self.width / 2, self.height / 2, 0
        return np.asarray(self._board.getObjPoints(), float) - middle

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Return the corners of markers."""
        return find_markers(self._board.getDictionary(), picture, 1, len(self.corners()))

    def draw(self, pixels: int) -> np.ndarray:
        """Draw squares and markers."""
        return np.asarray(
            self._board.generateImage((self.columns * pixels, self.rows * pixels), marginSize=0)
        )


@dataclass(frozen=True)
class AprilGrid(Printed):
    """
    Kalibr's grid of AprilTags 36h11, from below; with a black square at each of their corners.

    Attributes
    ----------
    gap : float
        Between two tags, metres.

    """

    gap: float = 0.01

    @property
    def width(self) -> float:
        """Return the size across with the outer squares, metres."""
        return self.columns * (self.square + self.gap) + self.gap

    @property
    def height(self) -> float:
        """Return the size down with the outer squares, metres."""
        return self.rows * (self.square + self.gap) + self.gap

    def _places(self) -> np.ndarray:
        # (N, 2) upper left corners from the upper left corner of the board, by number.
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        step = self.square + self.gap
        return np.stack([column, self.rows - 1 - row], axis=1) * step + self.gap

    def corners(self) -> np.ndarray:
        """Return (N, 4, 3) corners of the tags."""
        around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * self.square
        flat = self._places()[:, None] + around - np.array([self.width, self.height]) / 2
        return np.pad(flat, ((0, 0), (0, 0), (0, 1)))

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Return the corners of tags."""
        found = find_markers(_tags(), picture, 2, self.columns * self.rows)
        return {number: np.roll(quad, 2 * _turned(), axis=0) for number, quad in found.items()}

    def draw(self, pixels: int) -> np.ndarray:
        """Draw tags, and the squares between them."""
        side, gap = pixels, round(pixels * self.gap / self.square)
        step = side + gap
        size = self.rows * step + gap, self.columns * step + gap
        v, u = (np.arange(count) % step < gap for count in size)
        image = np.where(np.logical_and.outer(v, u), 0, 255).astype(np.uint8)
        places = np.rint(self._places() / (self.square + self.gap) - 0.5).astype(int) * step + gap
        for number, (x, y) in enumerate(places):
            tag = cv2.aruco.generateImageMarker(_tags(), number, side, borderBits=2)
            image[y : y + side, x : x + side] = np.rot90(tag, 2 * _turned())
        return image


def _tags() -> Any:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def _turned() -> bool:
    # Some versions of OpenCV have these tags upside down.
    first = cv2.aruco.generateImageMarker(_tags(), 0, 8)
    return bool((first[1, 1:7] > 0).astype(int).tolist() != _FIRST_ROW)


def read_board(given: str | Path) -> Target | Printed:
    """
    Return the board that a text or a file describes.

    Parameters
    ----------
    given : str or pathlib.Path
        ``chessboard:9x6:0.03`` as OpenCV counts inner corners, ``charuco:5x7:0.04:0.03:DICT`` as
        OpenCV counts squares, or a file: ``target.yaml``, or that of a target of Kalibr.

    Raises
    ------
    InputError
        When it is none of these, or impossible.

    """
    kind, *words = str(given).split(':')
    if kind in ('chessboard', 'charuco'):
        try:
            return (_chessboard if kind == 'chessboard' else _charuco)(*words)
        except (TypeError, ValueError, AttributeError, cv2.error):
            raise InputError(f'--board: must be {_FORMS}, got {shown(str(given))}') from None
    path = Path(given)
    content = read_mapping(path) if path.suffix == '.yaml' else {}
    if 'target_type' not in content:
        return read_target(path)
    makers: dict[str, Callable[[dict[str, Any]], Printed]] = {
        'aprilgrid': _april_grid, 'checkerboard': _kalibr_chessboard,
    }  # fmt: skip
    kind = content['target_type']
    if kind not in makers:
        raise InputError(
            f'{shown_path(path)}: target_type: must be one of {", ".join(makers)}, got '
            f'{shown(kind)}'
        )
    try:
        return makers[kind](content)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f'{shown_path(path)}: must be a target of Kalibr, got {error}') from None


def _count(value: Any, least: int = 1) -> int:
    count = int(value)
    if not least <= count <= _MOST_SQUARES:
        raise ValueError(f'{shown(value)} squares or tags')
    return count


def _metres(value: Any) -> float:
    metres = float(value)
    if not _LEAST <= metres <= _LARGEST:
        raise ValueError(f'{shown(value)} metres')
    return metres


def _chessboard(size: str, square: str) -> Printed:
    columns, rows = (_count(word, 3) + 1 for word in size.split('x'))
    return Chessboard(columns, rows, _metres(square))


def _charuco(size: str, square: str, marker: str, dictionary: str) -> Printed:
    columns, rows = (_count(word, 2) for word in size.split('x'))
    board = Charuco(columns, rows, _metres(square), marker=_metres(marker), dictionary=dictionary)
    board.corners()
    return board


def _april_grid(content: dict[str, Any]) -> Printed:
    tag = _metres(content['tagSize'])
    columns, rows = _count(content['tagCols']), _count(content['tagRows'])
    return AprilGrid(columns, rows, tag, gap=_metres(tag * float(content['tagSpacing'])))


def _kalibr_chessboard(content: dict[str, Any]) -> Printed:
    # Kalibr counts inner corners.
    columns, rows = _count(content['targetCols'], 3) + 1, _count(content['targetRows'], 3) + 1
    across, down = (_metres(content[f'{name}SpacingMeters']) for name in ('col', 'row'))
    if across != down:
        raise ValueError(f'squares of {across:g} x {down:g} m')
    return Chessboard(columns, rows, across)

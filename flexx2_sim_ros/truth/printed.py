"""Boards that people own: chessboards, ChArUco boards, grids of circles and of AprilTags."""

from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any

import cv2
import numpy as np

_FINER = 4  # pixels of a drawing in one of the picture that is asked for. ASSUMED
# The bits of the first tag of AprilTag 36h11, its first row. DEFINITION
_FIRST_ROW = [1, 1, 0, 1, 0, 1]
_EDGE_OF_MODULE = 0.3
# Diameters of circles, as parts of the distance between two, where they are not given. ASSUMED
_DIAMETERS = np.arange(0.25, 0.9, 0.05)
_MOST_SPOTS = 2  # dark spots in a picture, times the circles. ASSUMED


class Printed:
    """
    A flat board that gray images show.

    Its frame is in its middle: seen from the front, x points right, y down and z into the board.
    """

    white: float  # reflectivity at the camera's wavelength, 0 to 1
    flatness: float  # standard deviation of the surface from a plane, metres
    scale_error: float  # standard deviation of the printed size, as a fraction

    @property
    def size(self) -> tuple[float, float]:
        """Return width and height, metres."""
        raise NotImplementedError

    @property
    def turns(self) -> int:
        """Return of how many turns about its middle it looks the same to the detector."""
        return 1

    @property
    def kinds(self) -> 'tuple[Printed, ...]':
        """Return the boards that the description may mean."""
        return (self,)

    def corners(self) -> np.ndarray:
        """Return (N, C, 3) points that `find` finds, metres."""
        raise NotImplementedError

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Return (C, 2) points in an image, pixels, by their place in `corners`."""
        raise NotImplementedError

    def paint(self, step: float) -> np.ndarray:
        """Return (H, W) float32 its image about its middle: white fractions of `step` metres."""
        raise NotImplementedError


class Tagged(Printed):
    """A board of square tags, which are numbered from `first_id` on."""

    dictionary: str  # of its tags, as OpenCV names it
    first_id: int = 0
    border = 1  # modules of black around the code of a tag

    def codes(self) -> Any:
        """Return the dictionary; raises `AttributeError` where OpenCV has none of this name."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Return the (4, 2) corners of tags, pixels, by their place; none of those seen twice."""
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        settings.adaptiveThreshWinSizeMax = 53
        settings.markerBorderBits = self.border
        # Modules are only a few pixels wide and blurred: their edges are left out.
        settings.perspectiveRemoveIgnoredMarginPerCell = _EDGE_OF_MODULE
        quads, found, _ = cv2.aruco.ArucoDetector(self.codes(), settings).detectMarkers(picture)
        numbers = [] if found is None else [int(one) - self.first_id for one in found.ravel()]
        return {
            number: quad.reshape(4, 2)
            for number, quad in zip(numbers, quads, strict=True)
            if numbers.count(number) == 1 and 0 <= number < len(self.corners())
        }


def square_corners(places: np.ndarray, side: float) -> np.ndarray:
    """Return (N, 4, 3) corners of squares in OpenCV's order, from (N, 2) upper left corners."""
    around = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * side
    return np.pad(places[:, None] + around, ((0, 0), (0, 0), (0, 1)))


@dataclass(frozen=True)
class Cells(Printed):
    """A board of rows of equal cells, drawn at any size."""

    columns: int  # of squares, or of tags
    rows: int
    square: float  # side of a square, or of a tag with its black border, metres
    white: float = 0.8
    flatness: float = 0.001
    scale_error: float = 0.001

    @property
    def size(self) -> tuple[float, float]:
        return self.columns * self.square, self.rows * self.square

    def draw(self, pixels: int) -> np.ndarray:
        """Return an image of the board with so many pixels in a square; 255 for white."""
        raise NotImplementedError

    def paint(self, step: float) -> np.ndarray:
        size = [max(round(side / step), 1) for side in self.size]
        fine = self.draw(math.ceil(_FINER * self.square / step))
        return cv2.resize(fine, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255


@dataclass(frozen=True)
class Chessboard(Cells):
    """A chessboard; nothing is known of the paper around its squares."""

    first: str = 'black'  # colour of the upper left square

    @property
    def kinds(self) -> 'tuple[Printed, ...]':
        # Also the one of other colours, where no turn makes it of this one.
        even = (self.columns + self.rows) % 2 == 0 and self.columns != self.rows
        return (self, replace(self, first='white')) if even else (self,)

    @property
    def turns(self) -> int:
        return 4 if self.columns == self.rows else 2

    def corners(self) -> np.ndarray:
        across, down = (
            (np.arange(1, count) - count / 2) * self.square for count in (self.columns, self.rows)
        )
        x, y = np.meshgrid(across, down)
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)[None]

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        size = self.columns - 1, self.rows - 1
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        found, points = cv2.findChessboardCornersSB(picture, size, flags=flags)
        return {0: points.reshape(-1, 2)} if found else {}

    def draw(self, pixels: int) -> np.ndarray:
        cells = np.add.outer(np.arange(self.rows), np.arange(self.columns)) % 2
        if self.first == 'white':
            cells = 1 - cells
        return np.kron(cells, np.full((pixels, pixels), 255)).astype(np.uint8)


@dataclass(frozen=True)
class Charuco(Cells, Tagged):
    """OpenCV's chessboard with markers in its white squares."""

    marker: float = 0.02  # side of a marker, metres
    dictionary: str = 'DICT_5X5_100'

    @cached_property
    def _board(self) -> Any:
        size = self.columns, self.rows
        return cv2.aruco.CharucoBoard(size, self.square, self.marker, self.codes())

    def corners(self) -> np.ndarray:
        return np.asarray(self._board.getObjPoints(), float) - (*np.array(self.size) / 2, 0)

    def draw(self, pixels: int) -> np.ndarray:
        size = self.columns * pixels, self.rows * pixels
        return np.asarray(self._board.generateImage(size, marginSize=0))


@dataclass(frozen=True)
class AprilGrid(Cells, Tagged):
    """Kalibr's grid of AprilTags 36h11, from below, with black squares at their corners."""

    gap: float = 0.01  # between two tags, metres
    dictionary = 'DICT_APRILTAG_36h11'
    border = 2

    @property
    def size(self) -> tuple[float, float]:
        step = self.square + self.gap
        return self.columns * step + self.gap, self.rows * step + self.gap

    def _places(self) -> np.ndarray:
        # (N, 2) upper left corners from the upper left corner of the board, by number.
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        step = self.square + self.gap
        return np.stack([column, self.rows - 1 - row], axis=1) * step + self.gap

    def corners(self) -> np.ndarray:
        return square_corners(self._places(), self.square) - (*np.array(self.size) / 2, 0)

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        turn = 2 * self._turned()
        return {
            number: np.roll(quad, turn, axis=0) for number, quad in super().find(picture).items()
        }

    def _turned(self) -> bool:
        # Some versions of OpenCV have these tags upside down.
        first = cv2.aruco.generateImageMarker(self.codes(), 0, 8)
        return bool((first[1, 1:7] > 0).astype(int).tolist() != _FIRST_ROW)

    def draw(self, pixels: int) -> np.ndarray:
        side, gap = pixels, round(pixels * self.gap / self.square)
        step = side + gap
        size = self.rows * step + gap, self.columns * step + gap
        v, u = (np.arange(count) % step < gap for count in size)
        image = np.where(np.logical_and.outer(v, u), 0, 255).astype(np.uint8)
        places = np.rint(self._places() / (self.square + self.gap) - 0.5).astype(int) * step + gap
        for number, (x, y) in enumerate(places):
            tag = cv2.aruco.generateImageMarker(self.codes(), number, side, borderBits=2)
            image[y : y + side, x : x + side] = np.rot90(tag, 2 * self._turned())
        return image


@dataclass(frozen=True)
class CircleGrid(Cells):
    """OpenCV's grid of dark circles, on paper that is white for half a distance around them."""

    # Every second row is shifted by a square, and a row has every second column only.
    asymmetric: bool = False
    diameter: float = 0.0  # of a circle, metres; 0 if it is not known

    @property
    def kinds(self) -> 'tuple[Printed, ...]':
        usual = [self.diameter] if self.diameter else (_DIAMETERS * self.pitch).tolist()
        return tuple(replace(self, diameter=one) for one in usual)

    @property
    def turns(self) -> int:
        if self.asymmetric:
            return 2 - self.rows % 2
        return 4 if self.columns == self.rows else 2

    @property
    def pitch(self) -> float:
        """Return the distance between a circle and the nearest one, metres."""
        return self.square * (math.sqrt(2) if self.asymmetric else 1)

    @property
    def size(self) -> tuple[float, float]:
        steps = 2 * self.columns - 1 if self.asymmetric else self.columns - 1
        return steps * self.square + self.pitch, (self.rows - 1) * self.square + self.pitch

    def corners(self) -> np.ndarray:
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        across = 2 * column + row % 2 if self.asymmetric else column
        points = np.stack([across, row, np.zeros(len(row))], axis=1) * self.square
        return np.asarray(points - points.max(axis=0) / 2)[None]

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        count = self.columns * self.rows
        spots = np.array([spot.pt for spot in _spots(picture).detect(picture)], np.float32)
        # The search in many others takes minutes.
        if not count <= len(spots) <= _MOST_SPOTS * count:
            return {}
        kind = cv2.CALIB_CB_ASYMMETRIC_GRID if self.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
        grid: Any = cv2.findCirclesGrid
        size, settings = (self.columns, self.rows), cv2.CirclesGridFinderParameters()
        for way in (kind, kind | cv2.CALIB_CB_CLUSTERING):
            found, points = grid(spots[:, None], size, way, None, settings)
            if found:
                return {0: points.reshape(-1, 2)}
        return {}

    def draw(self, pixels: int) -> np.ndarray:
        scale = pixels / self.square
        image = np.full([round(side * scale) for side in self.size[::-1]], 255, np.uint8)
        places = self.corners()[0, :, :2] + np.array(self.size) / 2
        # In 1/16 of a pixel, whose centre is a whole number.
        for place in np.rint((places * scale - 0.5) * 16).astype(int).tolist():
            cv2.circle(
                image, place, round(8 * (self.diameter * scale - 1)), 0, cv2.FILLED, cv2.LINE_AA, 4
            )
        return image


def _spots(picture: np.ndarray) -> Any:
    # OpenCV's detector of dark spots, of those that may be circles seen askew.
    vision: Any = cv2
    settings = vision.SimpleBlobDetector_Params()
    settings.minDistBetweenBlobs, settings.minArea = 3, 20
    settings.maxArea = picture.size / 20
    settings.filterByInertia, settings.minConvexity = False, 0.85
    return vision.SimpleBlobDetector_create(settings)

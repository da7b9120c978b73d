"""Ground truth of a recording on a board."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

from flexx2_sim_ros.truth.board import BoardRoom, plane_covariance
from flexx2_sim_ros.truth.board_placing import BoardJob, BoardPoses
from flexx2_sim_ros.truth.clean import Clean, difference, OUTSIDE, REFUSED, render
from flexx2_sim_ros.truth.gray import Gray, white_fraction
from flexx2_sim_ros.truth.gray_frames import gray_images
from flexx2_sim_ros.truth.observation import Footage, grow, Observation
from flexx2_sim_ros.truth.plane_finding import surface_around
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.registration import frame
from flexx2_sim_ros.truth.writing import PageImages, picture_of, without_hidden
import numpy as np

_FITS, _FITS_NOISE = 0.05, 3.0  # metres and standard deviations of the residual, as for a scan
_BORDER = 2  # pixels
_ELSEWHERE = 0.5  # reflectivity where it is unknown


@dataclass(frozen=True)
class OnBoard:
    """
    How well the depth of a recording agrees with the board.

    Attributes
    ----------
    pose : tuple of float
        Pose of the camera in the frame of the board, in the first frame that shows it; see
        `Pose.numbers`.
    distance : float
        Median clean depth, metres.
    difference : float
        Median of measured minus clean depth, metres; NaN without valid pixels.
    fitting : float
        Fraction of the known pixels whose depth is near that median.
    deviation : tuple of float
        Standard deviation of the plane: metres along its normal, degrees about its worse axis.
    frames : int
        Number of frames that show the board.

    """

    pose: tuple[float, ...]
    distance: float
    difference: float
    fitting: float
    deviation: tuple[float, float]
    frames: int


@dataclass(frozen=True)
class _Shown:
    # The first frame that shows the board.
    number: int
    image: Observation
    clean: Clean
    pose: Pose


@dataclass(frozen=True)
class BoardSurfaces:
    """A board as a recording shows it; see `Surfaces`."""

    job: BoardJob
    placed: BoardPoses

    @property
    def moving(self) -> bool:
        """Return whether the camera moved."""
        return self.placed.moving

    def at(self, footage: Footage, number: int) -> None:
        """Return nothing: the reflectivity of a board is known."""

    def truths(self, footage: Footage) -> list[Clean]:
        """Return the board in each frame, or in the median of a still recording."""
        frames = map(footage.observe, footage.frames()) if self.moving else [footage.still]
        return [
            _unknown(image)
            if numbers is None
            else without_hidden(_clean(self, image, numbers), image)
            for image, numbers in zip(frames, self.placed.poses, strict=True)
        ]

    def accuracy(self, footage: Footage, truths: Sequence[Clean]) -> dict[str, np.ndarray]:
        """Return the covariance of the pose and, if the camera stood still, of the plane."""
        covariance = {'pose_covariance': self._covariance}
        if self.moving:
            return covariance
        return {
            **covariance,
            'plane': truths[0].known.astype(np.uint8),
            'plane_covariance': self._plane(_first(self, footage), truths),
            'plane_names': np.array(['board']),
        }

    def shown(
        self, footage: Footage, truths: Sequence[Clean], shares: dict[str, float]
    ) -> tuple[PageImages, OnBoard]:
        """Return images of the first frame that shows the board, and how well depth agrees."""
        first = _first(self, footage)
        gray = next(islice(gray_images(footage.reader, self.moving), first.number, None))
        picture = picture_of(truths[first.number], first.image, shares)
        judged = _judged(first, self._plane(first, truths), len(self._covariances))
        return replace(picture, image=gray.astype(np.float32)), judged

    @property
    def _covariances(self) -> list[np.ndarray]:
        return [one for one in self.placed.covariances if one is not None]

    @property
    def _covariance(self) -> np.ndarray:
        return np.asarray(np.mean(self._covariances, axis=0))

    def _plane(self, first: _Shown, truths: Sequence[Clean]) -> np.ndarray:
        known = truths[first.number].known
        known = known if known.any() else first.clean.known
        points = first.image.directions[known] * first.clean.depth[known, None]
        return plane_covariance(first.pose, self._covariance, points.mean(axis=0))


def _first(board: BoardSurfaces, footage: Footage) -> _Shown:
    number = next(i for i, numbers in enumerate(board.placed.poses) if numbers is not None)
    image = frame(footage, number) if board.moving else footage.still
    numbers = board.placed.poses[number]
    assert numbers is not None
    clean = _clean(board, image, numbers)
    return _Shown(number, image, clean, Pose.from_numbers(np.array(numbers)))


def _clean(board: BoardSurfaces, image: Observation, numbers: tuple[float, ...]) -> Clean:
    pose, target = Pose.from_numbers(np.array(numbers)), board.job.target
    clean = render(BoardRoom(target), pose, image.rays, target.flatness)
    if board.job.wall:
        seen = surface_around(image, pose.R[2] / -pose.t[2], clean.known & image.smooth)
        wall = render(BoardRoom(target, endless=True), pose, image.rays, target.flatness)
        seen |= clean.known
        part = np.where(grow(~seen, _BORDER) & wall.known, np.uint8(REFUSED), wall.part)
        part[~seen] = OUTSIDE
        clean = replace(wall, part=part)
    # The ratio of black to white is measured in the gray image; white itself comes from the file.
    gray = Gray(np.ones(image.depth.shape), image.rays)
    white = white_fraction(target, gray, pose, board.placed.blur)
    black = target.white * board.placed.contrast
    mixed = np.where(np.isfinite(white), black + (target.white - black) * white, _ELSEWHERE)
    return replace(clean, reflectivity=mixed.astype(np.float32))


def _unknown(image: Observation) -> Clean:
    nothing = np.full(image.depth.shape, np.nan, np.float32)
    part = np.full(nothing.shape, OUTSIDE, np.uint8)
    return Clean(nothing, nothing, nothing, part, np.zeros(nothing.shape, np.float32))


def _judged(shown: _Shown, plane: np.ndarray, frames: int) -> OnBoard:
    known = shown.clean.known
    error = difference(shown.clean, shown.image)[known]
    valid = np.isfinite(error)
    middle = float(np.median(error[valid])) if valid.any() else float('nan')
    near = np.abs(error - middle) < _FITS + _FITS_NOISE * shown.image.sigma[known]
    return OnBoard(
        tuple(shown.pose.numbers()),
        float(np.median(shown.clean.depth[known])),
        middle,
        float(near.mean()),
        (
            float(np.sqrt(plane[0, 0])),
            float(np.degrees(np.sqrt(np.linalg.eigvalsh(plane[1:, 1:])[-1]))),
        ),
        frames,
    )

"""Write a recording with ground truth on a board."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.board import BoardRoom, plane_covariance
from flexx2_sim_ros.truth.board_placing import BoardJob, BoardPoses
from flexx2_sim_ros.truth.clean import Clean, difference, OUTSIDE, render
from flexx2_sim_ros.truth.gray import Gray, white_fraction
from flexx2_sim_ros.truth.gray_frames import gray_images
from flexx2_sim_ros.truth.observation import Observation, observe
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.writing import PageImages, picture_of, without_hidden, write_truth
import numpy as np

_FITS, _FITS_NOISE = 0.05, 3.0  # metres and standard deviations of the residual, as for a scan
_ELSEWHERE = 0.5  # reflectivity where it is unknown


@dataclass(frozen=True)
class BoardWriting:
    """
    A recording to write, and the board in it.

    Attributes
    ----------
    job : BoardJob
    placed : BoardPoses
    target : pathlib.Path
        The file to write.
    keys : mapping of str to numpy.ndarray
        Further keys to write.

    """

    job: BoardJob
    placed: BoardPoses
    target: Path
    keys: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class OnBoard:
    """
    How well the depth of a recording agrees with the board.

    Attributes
    ----------
    picture : PageImages
        Images of the first frame that shows the board.
    pose : tuple of float
        Pose of the camera in the frame of the board in this frame, see `Pose.numbers`.
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

    picture: PageImages
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


def write_board(what: BoardWriting) -> OnBoard:
    """
    Write a recording with `clean_depth` on its board, whole or not at all.

    Raises
    ------
    InputError
        When the recording cannot be read or the file cannot be written.

    """
    reader = open_recording(what.job.path, what.job.camera, what.job.profile)
    moving, placed = what.placed.moving, what.placed
    footage = observe(reader, what.job.profile, 'moving' if moving else 'still')
    room = BoardRoom(what.job.target)
    images = map(footage.observe, footage.frames()) if moving else [footage.still]
    truths: list[Clean] = []
    shown: _Shown | None = None
    for image, numbers in zip(images, placed.poses, strict=True):
        if numbers is None:
            truths.append(_unknown(image))
            continue
        pose = Pose.from_numbers(np.array(numbers))
        clean = _with_reflectivity(
            render(room, pose, image.rays, what.job.target.flatness), what, image, pose
        )
        truths.append(without_hidden(clean, image))
        if shown is None:
            shown = _Shown(len(truths) - 1, image, clean, pose)
    assert shown is not None  # recordings without a pose were refused before
    covariances = [np.array(one) for one in placed.covariances if one is not None]
    covariance = np.mean(covariances, axis=0)
    plane = _plane_of(shown, truths[shown.number].known, covariance)
    accuracy = {'pose_covariance': covariance}
    if not moving:
        accuracy = {
            'plane': truths[0].known.astype(np.uint8),
            'plane_covariance': plane,
            'plane_names': np.array(['board']),
        }
    shares = write_truth(reader, what.target, truths, moving, {**accuracy, **what.keys})
    gray = next(islice(gray_images(reader, moving), shown.number, None))
    picture = replace(
        picture_of(truths[shown.number], shown.image, shares), image=gray.astype(np.float32)
    )
    return _judged(picture, shown, plane, len(covariances))


def _unknown(image: Observation) -> Clean:
    nothing = np.full(image.depth.shape, np.nan, np.float32)
    part = np.full(nothing.shape, OUTSIDE, np.uint8)
    return Clean(nothing, nothing, nothing, part, np.zeros(nothing.shape, np.float32))


def _with_reflectivity(clean: Clean, what: BoardWriting, image: Observation, pose: Pose) -> Clean:
    # The ratio of black to white is measured in the gray image; white itself comes from the file.
    target = what.job.target
    gray = Gray(np.ones(image.depth.shape), image.rays)
    white = white_fraction(target, gray, pose, what.placed.blur)
    black = target.white * what.placed.contrast
    mixed = np.where(np.isfinite(white), black + (target.white - black) * white, _ELSEWHERE)
    return replace(clean, reflectivity=mixed.astype(np.float32))


def _plane_of(shown: _Shown, known: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    known = known if known.any() else shown.clean.known
    points = shown.image.directions[known] * shown.clean.depth[known, None]
    return plane_covariance(shown.pose, covariance, points.mean(axis=0))


def _judged(picture: PageImages, shown: _Shown, plane: np.ndarray, frames: int) -> OnBoard:
    known = shown.clean.known
    error = difference(shown.clean, shown.image)[known]
    valid = np.isfinite(error)
    middle = float(np.median(error[valid])) if valid.any() else float('nan')
    near = np.abs(error - middle) < _FITS + _FITS_NOISE * shown.image.sigma[known]
    return OnBoard(
        picture,
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

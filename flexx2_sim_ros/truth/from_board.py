"""Ground truth from a printed board: find it in gray images, and render its plane."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.truth.absorbed import never_decided
from flexx2_sim_ros.truth.board import find_board, likeness, plane_covariance, read_board
from flexx2_sim_ros.truth.clean import (
    Clean,
    difference,
    OUTSIDE,
    REFUSED,
    render_plane,
    unknown,
    without_hidden,
)
from flexx2_sim_ros.truth.gray import Gray, GrayFit, inside, white_fraction
from flexx2_sim_ros.truth.observation import Footage, gray_images, grow, has_gray, Observation
from flexx2_sim_ros.truth.plane_finding import surface_around
from flexx2_sim_ros.truth.printed import Printed
from flexx2_sim_ros.truth.run import BoardRequest, GivenRecording, Run
from flexx2_sim_ros.truth.writing import GroundTruth, Surfaces, Written
import numpy as np

_MOST_METRES, _MOST_DEGREES = 0.01, 2.0  # standard deviation of the plane
_LEAST_FITTING = 0.5
_MOST_BIAS = 0.08  # metres: calibrated cameras are off by less than 50 mm
_TRIED = 4  # recordings that tell which of several boards it is. ASSUMED
# A depth error that grows with distance by more than this fraction is no offset. Prints that were
# scaled to fit the page are off by 3 to 6 %; a calibrated camera's scale is right to 0.5 %.
_MOST_SCALE = 0.02
_LEAST_SPREAD = 0.2  # metres between the nearest and the farthest board that distinguish the two
_FITS, _FITS_NOISE = 0.05, 3.0  # metres and standard deviations of the residual, as for a scan
_BORDER = 2  # pixels
_ELSEWHERE = 0.5  # reflectivity where it is unknown


@dataclass(frozen=True)
class BoardPoses:
    """The poses of the camera in the frame of the board in a recording."""

    moving: bool = False
    # One, or one a frame if it moves; None where the board is not found.
    poses: tuple[Pose | None, ...] = ()
    covariances: tuple[np.ndarray, ...] = ()  # (6, 6) of the motions of those that are found
    blur: float = 0.0  # median, as of `GrayFit`
    contrast: float = 0.0
    reason: str = ''  # why the board is not found; empty if it is found in a frame


@dataclass(frozen=True)
class BoardSurfaces(Surfaces):
    """A board in a recording."""

    target: Printed

    def truth(self, footage: Footage) -> GroundTruth:
        """Return the board in each frame, or in the median of a still recording."""
        poses = self.placed.poses
        number, pose = next((i, one) for i, one in enumerate(poses) if one is not None)
        cleans = []
        for i, (frame, there) in enumerate(zip(footage.images(), poses, strict=True)):
            if there is None:
                nothing = unknown(frame)
                cleans.append(replace(nothing, reflectivity=nothing.depth))
                continue
            whole = self._clean(frame, there)
            cleans.append(without_hidden(whole, frame))
            if i == number:
                image, clean = frame, whole
        covariance = np.asarray(np.mean(self.placed.covariances, axis=0))
        known = cleans[number].known if cleans[number].known.any() else clean.known
        points = image.directions[known] * clean.depth[known, None]
        plane = plane_covariance(pose, covariance, points.mean(axis=0))
        keys = {'pose_covariance': covariance}
        if not self.placed.moving:
            keys['plane'] = cleans[0].known.astype(np.uint8)
            keys['plane_covariance'] = plane
            keys['plane_names'] = np.array(['board'])
        gray = next(islice(gray_images(footage.reader, self.placed.moving), number, None))
        found = _judged(image, clean, pose, plane)
        return GroundTruth(cleans, image, keys, number, gray, found)

    def _clean(self, image: Observation, pose: Pose) -> Clean:
        target, inverse = self.target, pose.R[2] / -pose.t[2]
        seen = inside(target, pose, image.rays)
        clean = render_plane(image, inverse, target.flatness, self.given.request.wall | seen)
        if self.given.request.wall:
            core = ~grow(~seen, _BORDER)
            seen = core | surface_around(image, inverse, core & image.smooth)
        part = np.where(grow(~seen, _BORDER), np.uint8(REFUSED), clean.part)
        part[~seen] = OUTSIDE
        # The ratio of black to white is measured in the gray image; white comes from the file.
        gray = Gray(np.ones(image.depth.shape), image.rays)
        white = white_fraction(target, gray, pose, self.placed.blur)
        black = target.white * self.placed.contrast
        mixed = np.where(np.isfinite(white), black + (target.white - black) * white, _ELSEWHERE)
        return replace(clean, part=part, reflectivity=mixed.astype(np.float32))


def place_board(given: GivenRecording, target: Printed) -> BoardPoses:
    """Find the board in a recording, or the reason why it is not found."""
    footage = given.footage()
    reader, moving = footage.reader, footage.moving
    if not has_gray(reader, moving):
        one = has_gray(reader)
        why = 'has one gray image for all frames, but moves' if one else 'has no gray image'
        return BoardPoses(moving, (None,), reason=f'it {why}{"" if one else " (amplitude)"}')
    found: list[GrayFit | str] = []
    for image in gray_images(reader, moving):
        before = found[-1] if found and isinstance(found[-1], GrayFit) else None
        gray = Gray(image, footage.still.rays)
        found.append(find_board(target, gray, given.request.lens_error, before))
    fits = [fit for fit in found if isinstance(fit, GrayFit)]
    reasons = [fit for fit in found if isinstance(fit, str)]
    return BoardPoses(
        moving,
        tuple(None if isinstance(fit, str) else fit.pose for fit in found),
        tuple(fit.covariance for fit in fits),
        float(np.median([fit.blur for fit in fits])) if fits else 0.0,
        float(np.median([fit.contrast for fit in fits])) if fits else 0.0,
        '' if fits else max(set(reasons), key=reasons.count),
    )


def compare(given: GivenRecording, kinds: Sequence[Printed]) -> tuple[float, ...]:
    """Return how much a recording looks like each board that may be meant; none: not found."""
    footage = given.footage()
    images = gray_images(footage.reader, footage.moving) if has_gray(footage.reader) else ()
    likes = (likeness(kinds, Gray(image, footage.still.rays)) for image in images)
    return next((like for like in likes if like), ())


def _judged(image: Observation, clean: Clean, pose: Pose, plane: np.ndarray) -> dict[str, Any]:
    # How well depth agrees with the board in the first frame that shows it.
    known = clean.known
    error = difference(clean, image)[known]
    valid = np.isfinite(error)
    middle = float(np.median(error[valid])) if valid.any() else float('nan')
    near = np.abs(error - middle) < _FITS + _FITS_NOISE * image.sigma[known]
    turn = np.sqrt(np.linalg.eigvalsh(plane[1:, 1:])[-1])
    return {
        'pose': [round(value, 6) for value in pose.numbers()],
        'distance': float(np.median(clean.depth[known])),
        'off': middle,  # median of measured minus clean depth, metres; NaN without valid pixels
        'fitting': float(near.mean()),
        'metres': float(np.sqrt(plane[0, 0])),  # standard deviations of the plane
        'degrees': float(np.degrees(turn)),
    }


class BoardSource:
    """A printed board; see `Source`."""

    kind, step, kinds, lit = 'board', 'finding the board', (BoardPoses, Pose), False
    unread = {'motion': 'still', 'frames': 1, 'fitting': 0.0}
    place = staticmethod(place_board)

    def __init__(self, request: BoardRequest) -> None:
        """Read the description of the board."""
        self.request = request
        self.target = read_board(request.board)
        self.files = [Path(request.board)]

    def jobs(self, run: Run, given: Sequence[GivenRecording]) -> Sequence[tuple[Any, ...]]:
        """Return each recording and its board: which of those that may be meant, they show."""
        kinds = self.target.kinds
        self.target = kinds[0]
        if len(kinds) > 1:
            jobs = [(one, kinds) for one in given[:_TRIED]]
            found = run.each_once('telling boards apart', (0.0, 0.05), compare, jobs)
            like = [one for one in found if one and not isinstance(one, str)]
            self.target = kinds[int(np.sum(like, axis=0).argmax())]
        return [(one, self.target) for one in given]

    def solve(
        self, run: Run, given: Sequence[GivenRecording], found: Mapping[int, BoardPoses]
    ) -> dict[int, Surfaces]:
        """Return the board in recordings that show it."""
        self.found = found
        return {
            i: BoardSurfaces(given[i], one, self.target)
            for i, one in found.items()
            if not one.reason
        }

    def rows(self, written: Mapping[int, Written]) -> dict[int, dict[str, Any]]:
        """Return where the board is in each recording, and how well depth agrees with it."""
        self.scale = _scale([one.found for one in written.values()])
        rows = {}
        for i, one in self.found.items():
            motion, frames = ('moving', len(one.poses)) if one.moving else ('still', 1)
            row: dict[str, Any] = {'verdict': 'refused', 'reasons': [one.reason]}
            row |= {'motion': motion, 'frames': frames, 'fitting': 0.0}
            rows[i] = row | _numbers(written[i], one, self.scale) if i in written else row
        return rows

    def about(self) -> dict[str, Any]:
        """Return what was known of the board."""
        return {
            'board': str(self.request.board),
            'board_size_m': list(self.target.size),
            'lens_error': self.request.lens_error,
            'reflectivity': {'kind': 'anchored', 'white': self.target.white},
        }

    def findings(self) -> dict[str, Any]:
        """Return what the board cannot decide, and whether depth grows with distance."""
        scale = {} if self.scale is None else {'depth_scale': round(self.scale, 5)}
        return {
            'cannot_decide': never_decided(any(one.moving for one in self.found.values())),
            **scale,
        }


def _numbers(written: Written, placed: BoardPoses, scale: float | None) -> dict[str, Any]:
    found = written.found
    doubts = _doubts(found, scale)
    return {
        'verdict': 'doubtful' if doubts else 'used',
        'reasons': [*doubts, *written.notes],
        'frames_with_board': len(placed.covariances),
        'fitting': round(found['fitting'], 4),
        'pose': found['pose'],
        'pose_sigma_mm': round(found['metres'] * 1e3, 3),
        'pose_sigma_deg': round(found['degrees'], 4),
        'distance_m': round(found['distance'], 4),
        **written.table(),
        'blur_px': round(placed.blur, 3),
        'black_to_white': round(placed.contrast, 4),
        'residual_mm': round(found['off'] * 1e3, 3) if np.isfinite(found['off']) else None,
    }


def _doubts(found: Mapping[str, Any], scale: float | None) -> list[str]:
    doubts, off = [], found['off']
    if found['metres'] > _MOST_METRES or found['degrees'] > _MOST_DEGREES:
        doubts.append(
            f'its gray image does not hold the board: {found["metres"] * 1e3:.0f} mm and '
            f'{found["degrees"]:.1f} degrees; bring the board nearer or tilt it'
        )
    if found['fitting'] < _LEAST_FITTING:
        doubts.append(f'only {found["fitting"]:.0%} of the board has depth on one plane')
    if abs(off) > _MOST_BIAS:
        doubts.append(
            f'measured depth is {off * 1e3:+.0f} mm off the board, more than an offset is: '
            'measure the rulers on the print; the lens can be wrong, too'
        )
    elif scale is not None and abs(scale) > _MOST_SCALE:
        doubts.append(
            f'measured depth grows by {scale:+.1%} of distance, which no offset does: measure the '
            "rulers on the print; the lens or the depth's own scale can be wrong, too"
        )
    return doubts


def _scale(boards: Sequence[Mapping[str, Any]]) -> float | None:
    # The fraction of distance by which the difference between depth and board grows.
    off, distance = np.array([(one['off'], one['distance']) for one in boards]).reshape(-1, 2).T
    good = np.isfinite(off)
    if good.sum() < 2 or np.ptp(distance[good]) < _LEAST_SPREAD:
        return None
    return float(np.polyfit(distance[good], off[good], 1)[0])

"""Ground truth of a campaign from a printed board."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.truth.absorbed import never_decided
from flexx2_sim_ros.truth.board_placing import BoardJob, BoardPoses, place_board
from flexx2_sim_ros.truth.board_writing import BoardSurfaces, OnBoard
from flexx2_sim_ros.truth.files import digest
from flexx2_sim_ros.truth.page import figures, recordings_table, undecided, whole_page
from flexx2_sim_ros.truth.printed import Printed, read_board
from flexx2_sim_ros.truth.run import Run, TruthRequest, TruthSource, Work, Written
from flexx2_sim_ros.truth.shared import MOST_BIAS
from flexx2_sim_ros.truth.target import Target
from flexx2_sim_ros.truth.writing import PageImages, Writing
import numpy as np

_MOST_METRES, _MOST_DEGREES = 0.01, 2.0  # standard deviation of the plane
_LEAST_FITTING = 0.5
_TRIED = 4  # recordings that tell which of two boards it is. ASSUMED
# A depth error that grows with distance by more than this fraction is no offset. Prints that were
# scaled to fit the page are off by 3 to 6 %; a calibrated camera's scale is right to 0.5 %.
_MOST_SCALE = 0.02
_LEAST_SPREAD = 0.2  # metres between the nearest and the farthest board that distinguish the two


@dataclass(frozen=True, kw_only=True)
class BoardRequest(TruthRequest):
    """
    A request for ground truth from a printed board.

    The recordings have gray images; ``motion`` is that of the camera as seen from the board.

    Attributes
    ----------
    board : str or pathlib.Path
        The board, or its file; see `read_board`.
    lens_error : float
        Standard deviation of the focal length, as a fraction.
    wall : bool
        Whether the board is glued to a wall, whose rest is known as well.

    """

    board: str | Path
    lens_error: float = 0.003
    wall: bool = False

    def work(self) -> Work:
        """Return what is to be done for it."""
        return _Boards(self)


class _Boards:
    """The work of a `BoardRequest`; see `Work`."""

    kind, lit = 'board', False

    def __init__(self, request: BoardRequest) -> None:
        self.request = request
        self.kinds: Sequence[Target | Printed] = read_board(request.board).kinds
        self.files: Sequence[Path] = (Path(request.board),)

    def place(self, run: Run, sources: Sequence[TruthSource]) -> None:
        self.sources = sources
        target = max(self.kinds, key=lambda kind: self._found(run, kind))
        self.jobs, self.placed = self._placed(run, target, sources)
        if all(one.reason for one in self.placed):
            raise InputError(f'{shown_path(sources[0].path)}: {self.placed[0].reason}')

    def _found(self, run: Run, target: Target | Printed) -> int:
        # In how many of the first recordings it is found; these are not searched again.
        if len(self.kinds) == 1:
            return 0
        return sum(not one.reason for one in self._placed(run, target, self.sources[:_TRIED])[1])

    def _placed(
        self, run: Run, target: Target | Printed, sources: Sequence[TruthSource]
    ) -> tuple[list[BoardJob], list[BoardPoses]]:
        given = self.request
        jobs = [
            BoardJob(
                one.path,
                target,
                given.camera,
                given.profile,
                given.motion,
                given.lens_error,
                given.wall,
            )
            for one in sources
        ]
        digests = [digest((job.path,), list(vars(job).values())[1:]) for job in jobs]
        placed = run.each_once(
            'finding the board', (0.0, 0.7), place_board, jobs, digests, (BoardPoses,)
        )
        return jobs, placed

    def writings(self) -> dict[int, Writing]:
        return {
            i: self.request.writing(source, BoardSurfaces(job, one))
            for i, (source, job, one) in enumerate(
                zip(self.sources, self.jobs, self.placed, strict=True)
            )
            if not one.reason
        }

    def rows(self, written: Written) -> list[dict[str, Any]]:
        self.scale = _scale([board for _, board in written.values()])
        rows = []
        for i, (source, one) in enumerate(zip(self.sources, self.placed, strict=True)):
            row = source.row(
                'refused',
                [one.reason],
                motion='moving' if one.moving else 'still',
                frames=len(one.poses) if one.moving else 1,
                fitting=0.0,
            )
            rows.append(row | _numbers(*written[i], one, self.scale) if i in written else row)
        return rows

    def about(self) -> dict[str, Any]:
        target = self.jobs[0].target
        return {
            'board': str(self.request.board),
            'board_size_m': [target.width, target.height],
            'lens_error': self.request.lens_error,
            'reflectivity': {'kind': 'anchored', 'white': target.white},
        }

    def findings(self) -> dict[str, Any]:
        scale = {} if self.scale is None else {'depth_scale': round(self.scale, 5)}
        return {'cannot_decide': never_decided(any(one.moving for one in self.placed)), **scale}

    def page(self, table: dict[str, Any], written: Written) -> str:
        size = ' x '.join(f'{value * 1e3:g}' for value in table['board_size_m'])
        about = (
            f'Board: <code>{escape(table["board"])}</code>, {size} mm; focal length within '
            f'{table["lens_error"]:.1%} (given).'
        )
        parts = [undecided(table['cannot_decide']), recordings_table(table['recordings'])]
        caption = 'gray image, outline of the board as it was found in orange'
        for i, (picture, _) in written.items():
            name = table['recordings'][i]['name']
            parts.append(figures(name, picture, caption))
        return whole_page(table, about, parts)


def _numbers(
    picture: PageImages, board: OnBoard, placed: BoardPoses, scale: float | None
) -> dict[str, Any]:
    doubts = _doubts(board, scale)
    numbers: dict[str, Any] = {
        'verdict': 'doubtful' if doubts else 'used',
        'reasons': [*doubts, *picture.notes],
        'frames_with_board': board.frames,
        'fitting': round(board.fitting, 4),
        'pose': [round(value, 6) for value in board.pose],
        'pose_sigma_mm': round(board.deviation[0] * 1e3, 3),
        'pose_sigma_deg': round(board.deviation[1], 4),
        'distance_m': round(board.distance, 4),
        **picture.table(),
        'blur_px': round(placed.blur, 3),
        'black_to_white': round(placed.contrast, 4),
    }
    if np.isfinite(board.difference):
        numbers['residual_mm'] = round(board.difference * 1e3, 3)
    else:
        numbers['residual_mm'] = None
    return numbers


def _doubts(board: OnBoard, scale: float | None) -> list[str]:
    doubts = []
    if board.deviation[0] > _MOST_METRES or board.deviation[1] > _MOST_DEGREES:
        doubts.append(
            f'its gray image does not hold the board: {board.deviation[0] * 1e3:.0f} mm and '
            f'{board.deviation[1]:.1f} degrees; bring the board nearer or tilt it'
        )
    if board.fitting < _LEAST_FITTING:
        doubts.append(f'only {board.fitting:.0%} of the board has depth on one plane')
    if np.isfinite(board.difference) and abs(board.difference) > MOST_BIAS:
        doubts.append(
            f'measured depth is {board.difference * 1e3:+.0f} mm off the board, more than an '
            'offset is: measure the rulers on the print; the lens can be wrong, too'
        )
    elif scale is not None and abs(scale) > _MOST_SCALE:
        doubts.append(
            f'measured depth grows by {scale:+.1%} of distance, which no offset does: measure the '
            "rulers on the print; the lens or the depth's own scale can be wrong, too"
        )
    return doubts


def _scale(boards: Sequence[OnBoard]) -> float | None:
    # The fraction of distance by which the difference between depth and board grows.
    good = [board for board in boards if np.isfinite(board.difference)]
    distance = np.array([board.distance for board in good])
    if len(good) < 2 or np.ptp(distance) < _LEAST_SPREAD:
        return None
    slope, _ = np.polyfit(distance, [board.difference for board in good], 1)
    return float(slope)

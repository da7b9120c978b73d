"""Make a campaign with ground truth from recordings of a printed board."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.truth.absorbed import never_decided
from flexx2_sim_ros.truth.board_placing import BoardJob, BoardPoses, place_board
from flexx2_sim_ros.truth.board_writing import BoardWriting, OnBoard, write_board
from flexx2_sim_ros.truth.files import digest
from flexx2_sim_ros.truth.page import figures, recordings_table, undecided, whole_page
from flexx2_sim_ros.truth.printed import Printed, read_board
from flexx2_sim_ros.truth.run import (
    no_progress,
    Progress,
    Run,
    running,
    sources_of,
    TruthRequest,
    TruthSource,
    write_table,
)
from flexx2_sim_ros.truth.shared import MOST_BIAS
from flexx2_sim_ros.truth.target import Target
import numpy as np

_MOST_METRES, _MOST_DEGREES = 0.01, 2.0  # standard deviation of the plane
_LEAST_FITTING = 0.5
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

    """

    board: str | Path
    lens_error: float = 0.003


def make_board_truth(request: BoardRequest, progress: Progress = no_progress) -> dict[str, Any]:
    """
    Find a board in recordings and write them with ground truth on it.

    Parameters
    ----------
    request : BoardRequest
        The recordings and the board.
    progress : callable
        Called with the name of the current step and the fraction of the work that is done.

    Returns
    -------
    dict
        The content of ``truth.yaml``.

    Raises
    ------
    InputError
        When an input cannot be used, or no recording shows the board. Nothing is written
        then.

    """
    kinds = read_board(request.board).kinds
    sources = sources_of(request, Path(request.board))
    with running(request, progress) as run:
        tried = [_placed(run, request, target, sources) for target in kinds]
        jobs, placed = max(tried, key=lambda both: sum(not one.reason for one in both[1]))
        target = jobs[0].target
        if all(one.reason for one in placed):
            raise InputError(f'{shown_path(sources[0].path)}: {placed[0].reason}')
        writings = {
            i: BoardWriting(jobs[i], one, sources[i].target, sources[i].keys)
            for i, one in enumerate(placed)
            if not one.reason
        }
        found = run.each('writing', (0.7, 0.95), write_board, list(writings.values()))
        boards: dict[int, OnBoard] = dict(zip(writings, found, strict=True))
        scale = _scale(found)
        findings: dict[str, Any] = {
            'cannot_decide': never_decided(any(one.moving for one in placed))
        }
        if scale is not None:
            findings['depth_scale'] = round(scale, 5)
        return write_table(
            request,
            'board',
            {
                'board': str(request.board),
                'board_size_m': [target.width, target.height],
                'lens_error': request.lens_error,
                'reflectivity': {'kind': 'anchored', 'white': target.white},
            },
            [
                _row(source, one, boards.get(i), scale)
                for i, (source, one) in enumerate(zip(sources, placed, strict=True))
            ],
            findings,
            lambda table: _page(table, placed, boards),
        )


def _placed(
    run: Run, request: BoardRequest, target: Target | Printed, sources: Sequence[TruthSource]
) -> tuple[list[BoardJob], list[BoardPoses]]:
    jobs = [_job(request, target, source) for source in sources]
    digests = [digest((job.path,), list(vars(job).values())[1:]) for job in jobs]
    texts = run.each_once('finding the board', (0.0, 0.7), place_board, jobs, digests)
    return jobs, [BoardPoses.from_json(text) for text in texts]


def _job(request: BoardRequest, target: Target | Printed, source: TruthSource) -> BoardJob:
    return BoardJob(
        source.path, target, request.camera, request.profile, request.motion, request.lens_error
    )


def _row(
    source: TruthSource, one: BoardPoses, board: OnBoard | None, scale: float | None
) -> dict[str, Any]:
    row = source.row(
        'refused',
        [one.reason],
        motion='moving' if one.moving else 'still',
        frames=len(one.poses) if one.moving else 1,
        fitting=0.0,
    )
    return row if board is None else row | _numbers(board, one, scale)


def _numbers(board: OnBoard, placed: BoardPoses, scale: float | None) -> dict[str, Any]:
    doubts = _doubts(board, scale)
    numbers: dict[str, Any] = {
        'verdict': 'doubtful' if doubts else 'used',
        'reasons': [*doubts, *board.picture.notes],
        'frames_with_board': board.frames,
        'fitting': round(board.fitting, 4),
        'pose': [round(value, 6) for value in board.pose],
        'pose_sigma_mm': round(board.deviation[0] * 1e3, 3),
        'pose_sigma_deg': round(board.deviation[1], 4),
        'distance_m': round(board.distance, 4),
        **board.picture.table(),
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


def _page(
    table: dict[str, Any], placed: Sequence[BoardPoses], boards: Mapping[int, OnBoard]
) -> str:
    size = ' x '.join(f'{value * 1e3:g}' for value in table['board_size_m'])
    about = (
        f'Board: <code>{escape(table["board"])}</code>, {size} mm; focal length within '
        f'{table["lens_error"]:.1%} (given).'
    )
    parts = [undecided(table['cannot_decide']), recordings_table(table['recordings'])]
    for i, board in boards.items():
        parts.append(
            figures(
                table['recordings'][i]['name'],
                board.picture,
                'gray image, outline of the board as it was found in orange',
                placed[i],
                'misfit of gray values',
            )
        )
    return whole_page(table, about, parts)

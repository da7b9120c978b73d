"""The flow of `flexx2 gap truth`: observe, place, solve, write."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from flexx2_sim_ros import __version__
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.opening import find_recordings
from flexx2_sim_ros.truth.files import given_recordings, has_truth, write_results
from flexx2_sim_ros.truth.from_board import BoardSource
from flexx2_sim_ros.truth.from_planes import PlaneSource
from flexx2_sim_ros.truth.from_room import RoomSource
from flexx2_sim_ros.truth.page import page
from flexx2_sim_ros.truth.reflectivity import find_scale
from flexx2_sim_ros.truth.run import (
    BoardRequest,
    GivenRecording,
    no_progress,
    PlaneRequest,
    Progress,
    RoomRequest,
    Run,
    running,
    TruthRequest,
)
from flexx2_sim_ros.truth.writing import read_light, Surfaces, write_recording, Written

_LONGEST_COMMAND = 2000  # characters that are stored


class Source(Protocol):
    """Surfaces that are known: a room, a board or planes."""

    kind: str  # ``scan``, ``board`` or ``planes``
    step: str  # name of the step that places them
    kinds: tuple[type, ...]  # the dataclasses in what `place` returns
    unread: dict[str, Any]  # what ``truth.yaml`` says of a recording that cannot be used
    lit: bool  # reflectivity is to be taken from gray images
    files: Sequence[Path]  # that are read besides recordings
    # Place the surfaces in one recording; the arguments are those of `jobs`.
    place: Callable[..., Any]

    def jobs(self, run: Run, given: Sequence[GivenRecording]) -> Sequence[tuple[Any, ...]]:
        """Return the arguments of `place` for each recording."""

    def solve(
        self, run: Run, given: Sequence[GivenRecording], found: Mapping[int, Any]
    ) -> Mapping[int, Surfaces]:
        """Return the surfaces in recordings by what all show together; without refused ones."""

    def rows(self, written: Mapping[int, Written]) -> dict[int, dict[str, Any]]:
        """Return verdict, reasons and numbers of the recordings that have been placed."""

    def about(self) -> dict[str, Any]:
        """Return what was known of the surfaces."""

    def findings(self) -> dict[str, Any]:
        """Return what all recordings show together, and what they cannot decide."""


_SOURCES: dict[type[TruthRequest], Any] = {
    RoomRequest: RoomSource,
    BoardRequest: BoardSource,
    PlaneRequest: PlaneSource,
}


def make_truth(request: TruthRequest, progress: Progress = no_progress) -> dict[str, Any]:
    """
    Write recordings with ground truth.

    Parameters
    ----------
    request : TruthRequest
        A `RoomRequest`, `BoardRequest` or `PlaneRequest`.
    progress : callable
        Called with the name of the current step and the fraction of the work that is done.

    Returns
    -------
    dict
        The content of ``truth.yaml``.

    Raises
    ------
    InputError
        When an input cannot be used, or no recording shows the surfaces. Nothing is written then.

    """
    source: Source = _SOURCES[type(request)](request)
    given = given_recordings(request, source.files)
    with running(request, progress) as run:
        jobs = source.jobs(run, given)
        placed = run.each_once(source.step, (0.05, 0.55), source.place, jobs, source.kinds)
        found = {i: one for i, one in enumerate(placed) if not isinstance(one, str)}
        surfaces = source.solve(run, given, found) if found else {}
        written, light = _write(run, surfaces, source.lit)
        rows = source.rows(written) if found else {}
        for i, reason in enumerate(placed):
            if i not in found:
                rows[i] = {'verdict': 'refused', 'reasons': [reason], **source.unread}
        table = [one.row(**rows[i]) for i, one in enumerate(given)]
        others = _others(request.out, table)
        results = {
            'schema': 1,
            'kind': source.kind,
            'version': __version__,
            'command': _shortened(request.command),
            **source.about(),
            'recordings': table,
            **light,
            **source.findings(),
            **others,
        }
        write_results(request.out, results, page(results, written))
    return results


def _write(
    run: Run, surfaces: Mapping[int, Surfaces], lit: bool
) -> tuple[dict[int, Written], dict[str, Any]]:
    # Also, what gray values mean, for ``truth.yaml``.
    every, scale = list(surfaces.values()), None
    if lit:
        parts = run.each('reading gray images', (0.7, 0.75), read_light, every)
        scale = find_scale([one for part in parts for one in part])
    jobs = [(one, scale) for one in every]
    results = run.each('writing', (0.75, 0.95), write_recording, jobs)
    light = {} if scale is None else {'reflectivity': scale.table()}
    return dict(zip(surfaces, results, strict=True)), light


def _shortened(command: str) -> str:
    # A shell writes out thousands of recordings that a pattern names.
    if len(command) <= _LONGEST_COMMAND:
        return command
    half = _LONGEST_COMMAND // 2
    return f'{command[:half]} ... {command[-half:]}'


def _others(out: Path, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    # A diagnosis reads all recordings of the folder. So ground truth that an earlier run has
    # written of a recording that is refused now is removed, and others are listed.
    written = [row['name'] for row in rows if row['verdict'] != 'refused']
    for row in rows:
        if row['verdict'] == 'refused' and has_truth(out / row['name']):
            (out / row['name']).unlink()
    if not written:
        raise InputError(f'{rows[0]["source"]}: {"; ".join(rows[0]["reasons"])}')
    others = [path.name for path in find_recordings(out) if path.name not in written]
    return {'not_of_this_run': others} if others else {}

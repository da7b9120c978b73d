"""The flow of `flexx2 gap truth`: observe, place, solve, write."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.opening import find_recordings
from flexx2_sim_ros.truth.files import has_truth, sources_of, write_results
from flexx2_sim_ros.truth.from_board import BoardCampaign
from flexx2_sim_ros.truth.from_planes import PlaneCampaign
from flexx2_sim_ros.truth.from_room import RoomCampaign
from flexx2_sim_ros.truth.page import page
from flexx2_sim_ros.truth.reflectivity import find_scale
from flexx2_sim_ros.truth.run import (
    BoardRequest,
    no_progress,
    PlaneRequest,
    Progress,
    RoomRequest,
    running,
    TruthRequest,
)
from flexx2_sim_ros.truth.writing import read_light, write_recording, Writing

_LONGEST_COMMAND = 2000  # characters that are stored


# `kind` is ``scan``, ``board`` or ``planes``; `lit`: reflectivity is to be taken from gray images;
# `files` are read besides recordings. `rows` comes before `about` and `findings`.
_Campaign = RoomCampaign | BoardCampaign | PlaneCampaign
_KINDS: dict[type[TruthRequest], Any] = {
    RoomRequest: RoomCampaign,
    BoardRequest: BoardCampaign,
    PlaneRequest: PlaneCampaign,
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
    campaign: _Campaign = _KINDS[type(request)](request)
    sources = sources_of(request, campaign.files)
    with running(request, progress) as run:
        surfaces = campaign.place(run, sources)
        settings, light = request.settings(), {}
        every = [Writing(settings, sources[i], one) for i, one in surfaces.items()]
        if campaign.lit:
            lit = run.each('reading gray images', (0.7, 0.75), read_light, every)
            scale = find_scale([one for part in lit for one in part])
            every = [replace(one, scale=scale) for one in every]
            light = {} if scale is None else {'reflectivity': scale.table()}
        results = run.each('writing', (0.75, 0.95), write_recording, every)
        written = dict(zip(surfaces, results, strict=True))
        rows = campaign.rows(written)
        table = {
            'schema': 1,
            'kind': campaign.kind,
            'version': __version__,
            'command': _shortened(request.command),
            **campaign.about(),
            'recordings': rows,
            **light,
            **campaign.findings(),
            **_others(request.out, rows),
        }
        write_results(request.out, table, page(table, written))
    return table


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
        raise InputError(f'{rows[0]["source"]}: cannot be used: {"; ".join(rows[0]["reasons"])}')
    others = [path.name for path in find_recordings(out) if path.name not in written]
    return {'not_of_this_run': others} if others else {}

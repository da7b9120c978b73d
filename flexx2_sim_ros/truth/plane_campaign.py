"""From recordings of a room's planes to a campaign with ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
import shutil
from typing import Any

from flexx2_sim_ros import __version__, atomic
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.truth.files import (
    check_files,
    names_of,
    Progress,
    recordings_of,
    Steps,
    write_results,
)
from flexx2_sim_ros.truth.page import figures, undecided, whole_page
from flexx2_sim_ros.truth.plane_file import PlaneFile, read_planes
from flexx2_sim_ros.truth.plane_writing import Judged, place_planes, PlaneJob, write_planes
from flexx2_sim_ros.truth.writing import Picture

_FRONTAL = 20.0  # degrees between the normal and the optical axis
_POSE = {
    'effect': 'pose_error',
    'reason': "the planes are in the camera's frame, so that they move with it; motion capture "
    'would decide it',
}


@dataclass(frozen=True)
class PlaneRequest:
    """
    What to make ground truth from.

    Attributes
    ----------
    recordings : tuple of pathlib.Path
        Bags, ``.npz`` files, or folders of them; the camera stands still.
    planes : pathlib.Path
        ``planes.yaml``; see `read_planes`.
    out : pathlib.Path
        The campaign's folder.
    camera : str or None
        Of bags that have several.
    profile : Profile or None
    motion : str
        ``auto`` or ``still``.
    room_error : float
        Standard deviation of surfaces whose flatness the file does not say, metres.
    jobs : int
        Processes.
    scheduler : str or None
        Address of a Dask scheduler.
    command : str
        How it was asked for, to be written down.

    """

    recordings: tuple[Path, ...]
    planes: Path
    out: Path
    camera: str | None = None
    profile: Profile | None = None
    motion: str = 'auto'
    room_error: float = 0.0
    jobs: int = 1
    scheduler: str | None = None
    command: str = ''


def make_plane_truth(
    request: PlaneRequest, progress: Progress = lambda text, share: None
) -> dict[str, Any]:
    """
    Find planes in recordings and write them with ground truth on these planes.

    Parameters
    ----------
    request : PlaneRequest
        What to make it from.
    progress : callable
        Called with what is done and the fraction of all that is done.

    Returns
    -------
    dict
        What ``truth.yaml`` says.

    Raises
    ------
    InputError
        When something given cannot be used, or no recording shows the planes. Nothing is written
        then.

    """
    plan = read_planes(request.planes)
    paths = recordings_of(request.recordings)
    check_files(request.out, paths, request.camera)
    jobs = _jobs(request, plan, paths)
    new = not request.out.exists()
    try:
        with workers(request.jobs, request.scheduler) as mapped:
            steps = Steps(progress, 'finding planes', 0.0, 0.5, len(jobs))
            judged = mapped(place_planes, jobs, steps.tick)
            refused = [one for one in judged if one.planes is None]
            if len(refused) == len(judged):
                raise InputError(f'{shown_path(paths[0])}: {refused[0].reasons[0]}')
            good = {i: (jobs[i], one) for i, one in enumerate(judged) if one.planes is not None}
            atomic.output_folder(request.out)
            steps = Steps(progress, 'writing', 0.5, 0.45, len(good))
            written = mapped(write_planes, list(good.values()), steps.tick)
            pictures = dict(zip(good, written, strict=True))
    except InputError:
        if new:
            shutil.rmtree(request.out, ignore_errors=True)
        raise
    table = _table(request, plan, paths, judged, pictures)
    write_results(request.out, table, _page(table, pictures))
    return table


def _jobs(request: PlaneRequest, plan: PlaneFile, paths: Sequence[Path]) -> list[PlaneJob]:
    names = names_of(paths)
    for name in plan.changes:
        if f'{name}.npz' not in names:
            raise InputError(
                f'{shown_path(request.planes)}: recordings: must name recordings that are given, '
                f'got {name!r:.80}'
            )
    return [
        PlaneJob(
            path,
            request.out / name,
            plan.seen_in(name.removesuffix('.npz')),
            plan.angles,
            plan.origin,
            request.camera,
            request.profile,
            request.motion,
            request.room_error,
        )
        for path, name in zip(paths, names, strict=True)
    ]


def _table(
    request: PlaneRequest,
    plan: PlaneFile,
    paths: Sequence[Path],
    judged: Sequence[Judged],
    pictures: Mapping[int, Picture],
) -> dict[str, Any]:
    rows = []
    for i, (path, name, one) in enumerate(zip(paths, names_of(paths), judged, strict=True)):
        row: dict[str, Any] = {
            'name': name,
            'source': str(path),
            'verdict': one.state,
            'reasons': list(one.reasons),
        }
        if i in pictures:
            row |= {'known': round(pictures[i].known, 4), 'planes': one.table()}
        rows.append(row)
    return {
        'schema': 1,
        'kind': 'planes',
        'version': __version__,
        'command': request.command,
        'planes': str(request.planes),
        'origin_m': list(plan.origin),
        'room_error_mm': request.room_error * 1e3,
        'recordings': rows,
        'cannot_decide': _cannot_decide(judged),
    }


def _cannot_decide(judged: Sequence[Judged]) -> list[dict[str, str]]:
    # What is certain beforehand; the diagnosis computes the rest for each recording.
    found = [one for one in judged if one.planes is not None]
    taped = any(one.taped for one in found)
    out = [_POSE]
    if not taped:
        out.append(
            {
                'effect': 'offset',
                'reason': 'the planes may be nearer or farther, because no distance was measured; '
                'a tape measure would decide it',
            }
        )
    if all(one.frontal < _FRONTAL for one in found):
        out.append(
            {
                'effect': 'wiggling',
                'reason': 'all recordings show one wall from the front; views tilted by 40 '
                'degrees, and the distance of each, would decide it',
            }
        )
    return out


def _page(table: dict[str, Any], pictures: Mapping[int, Picture]) -> str:
    about = f'Planes: <code>{escape(table["planes"])}</code>.'
    parts = [undecided(table['cannot_decide']), _recordings(table['recordings'])]
    for i, picture in pictures.items():
        row = table['recordings'][i]
        parts.append(
            figures(
                row['name'],
                picture,
                'measured depth (dark is near), outlines of the known part of planes in orange',
            )
        )
    return whole_page(table, about, parts)


def _recordings(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for row in rows:
        planes = row.get('planes', ())
        known = f'{row["known"]:.0%}' if planes else ''
        lines.append(
            f'<tr><td>{escape(row["name"])}</td><td><span class="tag {row["verdict"]}">'
            f'{row["verdict"]}</span></td><td>{known}</td><td>'
            f'{"<br>".join(map(_plane, planes))}</td>'
            f'<td><small>{escape("; ".join(row["reasons"]))}</small></td></tr>'
        )
    return (
        '<h2>Recordings</h2><table><tr><th></th><th></th><th>known</th><th>planes: distance, '
        f'recording minus nominal</th><th></th></tr>{"".join(lines)}</table>'
    )


def _plane(row: Mapping[str, Any]) -> str:
    return (
        f'{escape(row["name"])}: {row["distance_m"]:.3f} m &plusmn; {row["sigma_mm"]:.1f} mm, '
        f'{row["residual_mm"]:+.1f} mm'
    )

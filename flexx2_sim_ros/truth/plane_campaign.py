"""Make a campaign with ground truth from recordings of planes of a room."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.truth.absorbed import absorbed, hidden_by_planes
from flexx2_sim_ros.truth.files import digest
from flexx2_sim_ros.truth.page import figures, known_share, undecided, whole_page, with_verdicts
from flexx2_sim_ros.truth.plane_file import PlaneFile, read_planes
from flexx2_sim_ros.truth.plane_writing import (
    Judged,
    place_planes,
    PlaneJob,
    PlaneWriting,
    read_plane_light,
    write_planes,
)
from flexx2_sim_ros.truth.reflectivity import find_scale
from flexx2_sim_ros.truth.run import (
    no_progress,
    Progress,
    running,
    sources_of,
    TruthRequest,
    TruthSource,
    write_table,
)
from flexx2_sim_ros.truth.writing import PageImages

_FRONTAL = 20.0  # degrees between the normal and the optical axis


@dataclass(frozen=True, kw_only=True)
class PlaneRequest(TruthRequest):
    """
    A request for ground truth from planes; the camera stands still in each recording.

    Attributes
    ----------
    planes : pathlib.Path
        ``planes.yaml``; see `read_planes`.
    room_error : float
        Standard deviation of surfaces whose flatness is not in the file, metres.

    """

    planes: Path
    room_error: float = 0.0


def make_plane_truth(request: PlaneRequest, progress: Progress = no_progress) -> dict[str, Any]:
    """
    Find planes in recordings and write them with ground truth on these planes.

    Parameters
    ----------
    request : PlaneRequest
        The recordings and the planes.
    progress : callable
        Called with the name of the current step and the fraction of the work that is done.

    Returns
    -------
    dict
        The content of ``truth.yaml``.

    Raises
    ------
    InputError
        When an input cannot be used, or no recording shows the planes. Nothing is written
        then.

    """
    plan = read_planes(request.planes)
    sources = sources_of(request, request.planes)
    jobs = _jobs(request, plan, sources)
    absent = sorted(set(plan.changes) - {source.target.stem for source in sources})
    with running(request, progress) as run:
        digests = [digest((job.path,), list(vars(job).values())[1:]) for job in jobs]
        texts = run.each_once('finding planes', (0.0, 0.5), place_planes, jobs, digests)
        judged = [Judged.from_json(text) for text in texts]
        refused = [one for one in judged if one.planes is None]
        if len(refused) == len(judged):
            raise InputError(f'{shown_path(sources[0].path)}: {refused[0].reasons[0]}')
        good = {
            i: PlaneWriting(jobs[i], one.planes, sources[i].keys)
            for i, one in enumerate(judged)
            if one.planes is not None
        }
        lit = run.each('reading gray images', (0.5, 0.6), read_plane_light, list(good.values()))
        scale = find_scale([one for part in lit for one in part])
        whole = [replace(writing, scale=scale) for writing in good.values()]
        written = run.each('writing', (0.6, 0.95), write_planes, whole)
        pictures = dict(zip(good, written, strict=True))
        return write_table(
            request,
            'planes',
            {
                'planes': str(request.planes),
                'origin_m': list(plan.origin),
                'room_error_mm': request.room_error * 1e3,
            },
            [
                _row(source, one, pictures.get(i))
                for i, (source, one) in enumerate(zip(sources, judged, strict=True))
            ],
            {
                **({} if scale is None else {'reflectivity': scale.table()}),
                **({'not_given': absent} if absent else {}),
                'cannot_decide': _cannot_decide(judged),
                'absorbed': absorbed(
                    'tape' if all(any(judged[i].taped) for i in good) else 'planes'
                ),
            },
            lambda table: _page(table, pictures),
        )


def asked_for(request: PlaneRequest) -> str:
    """
    Return what should be measured before the work, and what is not decided without; or nothing.

    Raises
    ------
    InputError
        When the file of the planes cannot be used.

    """
    plan = read_planes(request.planes)
    changed = [hint for rows in plan.changes.values() for hint in rows.values()]
    if any(hint is not None and hint.distance for hint in (*plan.planes, *changed)):
        return ''
    _, *rows = hidden_by_planes(False, bool(plan.angles))
    return (
        f'{shown_path(request.planes)}: no plane has a distance. Measure that of each plane from '
        'the camera, and write for example "distance: 1.20 +- 0.003". Without it '
        f'{", ".join(row["effect"] for row in rows)} cannot be decided'
    )


def _jobs(
    request: PlaneRequest, plan: PlaneFile, sources: Sequence[TruthSource]
) -> list[PlaneJob]:
    names = [source.target.stem for source in sources]
    return [
        PlaneJob(
            source.path,
            source.target,
            plan.seen_in(name),
            plan.angles,
            plan.origin,
            request.camera,
            request.profile,
            request.motion,
            request.room_error,
        )
        for source, name in zip(sources, names, strict=True)
    ]


def _row(source: TruthSource, one: Judged, picture: PageImages | None) -> dict[str, Any]:
    row = source.row(one.state, one.reasons)
    if picture is not None:
        row |= {**picture.table(), 'planes': one.table()}
    return row


def _cannot_decide(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    # The diagnosis computes others for each recording.
    found = [one for one in judged if one.planes is not None]
    taped = any(any(one.taped) for one in found)
    out = hidden_by_planes(taped, any(one.square for one in found))
    if all(one.frontal < _FRONTAL for one in found):
        out.append(
            {
                'effect': 'wiggling',
                'reason': 'all recordings show one wall from the front; views tilted by 40 '
                'degrees, and the distance of each, would decide it',
            }
        )
    return out


def _page(table: dict[str, Any], pictures: Mapping[int, PageImages]) -> str:
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
    cells = []
    for row in rows:
        planes = row.get('planes', ())
        known = known_share(row) if planes else ''
        cells.append(f'<td>{known}</td><td>{"<br>".join(map(_plane, planes))}</td>')
    heads = 'known', 'planes: distance, and how much farther the recording shows them'
    return with_verdicts(rows, heads, cells)


def _plane(row: Mapping[str, Any]) -> str:
    off = row['residual_mm']
    measured = (
        'not measured' if off is None else f'&plusmn; {row["sigma_mm"]:.1f} mm, {off:+.1f} mm'
    )
    return f'{escape(row["name"])}: {row["distance_m"]:.3f} m, {measured}'

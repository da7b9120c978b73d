"""Ground truth of a campaign from planes of a room."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.truth.absorbed import absorbed, hidden_by_planes
from flexx2_sim_ros.truth.files import digest
from flexx2_sim_ros.truth.page import figures, known_share, undecided, whole_page, with_verdicts
from flexx2_sim_ros.truth.plane_constraints import PlacedPlanes
from flexx2_sim_ros.truth.plane_file import read_planes
from flexx2_sim_ros.truth.plane_finding import ImagePlane
from flexx2_sim_ros.truth.plane_placing import (
    Judged,
    Nominal,
    place_planes,
    PlaneJob,
    PlaneSurfaces,
)
from flexx2_sim_ros.truth.run import Run, TruthRequest, TruthSource, Work, Written
from flexx2_sim_ros.truth.writing import Writing

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

    def work(self) -> Work:
        """Return what is to be done for it."""
        return _Planes(self)


class _Planes:
    """The work of a `PlaneRequest`; see `Work`."""

    kind, lit = 'planes', True

    def __init__(self, request: PlaneRequest) -> None:
        self.request, self.plan = request, read_planes(request.planes)
        self.files: Sequence[Path] = (request.planes,)

    def place(self, run: Run, sources: Sequence[TruthSource]) -> None:
        self.sources, given = sources, self.request
        self.jobs = [
            PlaneJob(
                source.path,
                self.plan.seen_in(source.target.stem),
                self.plan.angles,
                self.plan.origin,
                given.camera,
                given.profile,
                given.motion,
                given.room_error,
            )
            for source in sources
        ]
        digests = [digest((job.path,), list(vars(job).values())[1:]) for job in self.jobs]
        kinds = Judged, Nominal, ImagePlane, PlacedPlanes
        self.judged: list[Judged] = run.each_once(
            'finding planes', (0.0, 0.7), place_planes, self.jobs, digests, kinds
        )
        if all(one.planes is None for one in self.judged):
            raise InputError(f'{shown_path(sources[0].path)}: {self.judged[0].reasons[0]}')

    def writings(self) -> dict[int, Writing]:
        return {
            i: self.request.writing(source, PlaneSurfaces(job, one.planes))
            for i, (source, job, one) in enumerate(
                zip(self.sources, self.jobs, self.judged, strict=True)
            )
            if one.planes is not None
        }

    def rows(self, written: Written) -> list[dict[str, Any]]:
        rows = []
        for i, (source, one) in enumerate(zip(self.sources, self.judged, strict=True)):
            found = {**written[i][0].table(), 'planes': one.table()} if i in written else {}
            rows.append(source.row(one.state, one.reasons) | found)
        return rows

    def about(self) -> dict[str, Any]:
        return {
            'planes': str(self.request.planes),
            'origin_m': list(self.plan.origin),
            'room_error_mm': self.request.room_error * 1e3,
        }

    def findings(self) -> dict[str, Any]:
        absent = sorted(set(self.plan.changes) - {one.target.stem for one in self.sources})
        taped = all(any(one.taped) for one in self.judged if one.planes is not None)
        return {
            **({'not_given': absent} if absent else {}),
            'cannot_decide': _cannot_decide(self.judged),
            'absorbed': absorbed('tape' if taped else 'planes'),
        }

    def page(self, table: dict[str, Any], written: Written) -> str:
        about = f'Planes: <code>{escape(table["planes"])}</code>.'
        parts = [undecided(table['cannot_decide']), _recordings(table['recordings'])]
        caption = 'measured depth (dark is near), outlines of the known part of planes in orange'
        for i, (picture, _) in written.items():
            parts.append(figures(table['recordings'][i]['name'], picture, caption))
        return whole_page(table, about, parts)


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

"""Ground truth from planes of a room: find them in each recording, and move them to the tape."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.truth.absorbed import absorbed, hidden_by_planes
from flexx2_sim_ros.truth.clean import Clean, KNOWN, OUTSIDE, render_plane, unknown
from flexx2_sim_ros.truth.observation import Footage, Observation
from flexx2_sim_ros.truth.plane_constraints import (
    check_agreement,
    Constraints,
    doubts_of,
    PlacedPlanes,
    settle,
    turned,
)
from flexx2_sim_ros.truth.plane_file import PlaneFile, PlaneHint, read_planes
from flexx2_sim_ros.truth.plane_finding import find_planes, ImagePlane
from flexx2_sim_ros.truth.run import GivenRecording, PlaneRequest, Run, TruthRequest
from flexx2_sim_ros.truth.writing import GroundTruth, Surfaces, Written
import numpy as np

_FRONTAL = 20.0  # degrees between the normal and the optical axis


@dataclass(frozen=True)
class FoundPlanes:
    """The planes of a recording, whose camera stands still."""

    moving = False
    doubts: tuple[str, ...]
    notes: tuple[str, ...]
    surfaces: tuple[ImagePlane, ...]  # the P planes as fitted to the recording
    errors: tuple[float, ...]  # (P,) standard deviations of their surfaces, metres
    placed: PlacedPlanes  # the planes moved to the measurements
    covariance: np.ndarray  # (3 P, 3 P), as in recordings
    taped: tuple[bool, ...]  # of which of them a distance was measured
    square: bool  # an angle between two of them was measured

    @property
    def frontal(self) -> float:
        """Return the angle between optical axis and normal of the only plane, degrees; or inf."""
        if len(self.surfaces) > 1:
            return float('inf')
        return float(np.degrees(np.arccos(np.clip(self.placed.normals[0, 2], -1, 1))))

    def table(self) -> list[dict[str, Any]]:
        """Return the planes for ``truth.yaml``."""
        spread = np.sqrt(np.diag(self.covariance)).reshape(-1, 3)
        distances = self.placed.distance_deviations(self.covariance)
        away = self.placed.distances.tolist()
        return [
            {
                'name': one.name,
                'distance_m': round(away[k], 5),
                'normal': [round(float(value), 5) for value in self.placed.normals[k]],
                'sigma_mm': round(float(distances[k]) * 1e3, 2),
                'sigma_deg': round(float(np.degrees(spread[k, 1:].max())), 3),
                'residual_mm': round((one.distance - away[k]) * 1e3, 2) if self.taped[k] else None,
                'bend_mm': round(one.bend * 1e3, 2),
            }
            for k, one in enumerate(self.surfaces)
        ]


class PlaneSurfaces(Surfaces):
    """Planes in a recording."""

    def at(self, footage: Footage, number: int) -> Clean:
        """Return the planes as the image shows them."""
        return self._render(footage.still)[0]

    def truth(self, footage: Footage) -> GroundTruth:
        """Return the planes of the one image; its plane of each pixel, and their covariance."""
        clean, plane = self._render(footage.still)
        keys = {
            'plane': plane,
            'plane_covariance': self.placed.covariance,
            'plane_names': np.array([surface.name for surface in self.placed.surfaces]),
        }
        return GroundTruth([clean], footage.still, keys)

    def _render(self, image: Observation) -> tuple[Clean, np.ndarray]:
        # Pixels outside the planes are unknown.
        found, placed = self.placed, self.placed.placed
        out, plane = unknown(image), np.zeros(image.depth.shape, np.uint8)
        for k, (surface, error) in enumerate(zip(found.surfaces, found.errors, strict=True)):
            mask = surface.mask
            one = render_plane(image, placed.normals[k] / placed.distances[k], error, mask)
            for name in ('depth', 'incidence', 'sigma'):
                getattr(out, name)[mask] = getattr(one, name)[mask]
            plane[mask] = k + 1
            new = (surface.part != OUTSIDE) & (out.part != KNOWN)
            out.part[new] = surface.part[new]
        return out, plane


def place_planes(
    given: GivenRecording, hints: Sequence[PlaneHint], plan: PlaneFile
) -> FoundPlanes:
    """Find the planes of a recording and move them to the measurements of a file."""
    footage = given.footage()
    if footage.moving:
        raise InputError('the camera moves; planes need one that stands still')
    surfaces = find_planes(footage.still, hints)
    names = [surface.name for surface in surfaces]
    missing = [hint for hint in hints if hint.name not in names]
    for hint in missing:
        if hint.box or hint.outline:
            raise InputError(f'{hint.name}: no plane is found where the file says')
    if not surfaces:
        raise InputError('no plane is found in it')
    shown = [hint for hint in hints if hint.name in names]
    distances, usual = tuple(hint.distance for hint in shown), given.request.room_error
    angles = tuple(a for a in plan.angles if a.first in names and a.second in names)
    constraints = Constraints(tuple(names), distances, angles, plan.origin)
    notes = turned(surfaces, constraints)
    placed, covariance = settle(_fitted(surfaces, footage.still), constraints)
    check_agreement(placed, constraints)
    notes += [f'{hint.name}: not found' for hint in missing]
    notes += [note for surface in surfaces for note in surface.notes()]
    return FoundPlanes(
        tuple(doubts_of(surfaces, constraints)),
        tuple(notes),
        tuple(surfaces),
        tuple(usual if hint.flat is None else hint.flat for hint in shown),
        placed,
        covariance,
        tuple(distance is not None for distance in distances),
        bool(angles),
    )


def _fitted(surfaces: list[ImagePlane], image: Observation) -> PlacedPlanes:
    pivots = []
    for surface in surfaces:
        rays = image.directions[surface.mask]
        pivots.append((rays / (rays @ surface.inverse)[:, None]).mean(axis=0))
    return PlacedPlanes(
        np.stack([surface.normal for surface in surfaces]),
        np.array([surface.distance for surface in surfaces]),
        np.stack(pivots),
    )


class PlaneSource:
    """Planes that were measured; see `Source`."""

    kind, step, lit = 'planes', 'finding planes', True
    kinds = FoundPlanes, ImagePlane, PlacedPlanes
    unread: dict[str, Any] = {}
    place = staticmethod(place_planes)

    def __init__(self, request: PlaneRequest) -> None:
        """Read the file of the planes."""
        self.request, self.plan = request, read_planes(request.planes)
        self.files = [request.planes]

    def jobs(self, run: Run, given: Sequence[GivenRecording]) -> Sequence[tuple[Any, ...]]:
        """Return each recording, the planes that it shows, and what was measured of them."""
        self.names = [one.target.stem for one in given]
        return [
            (one, self.plan.seen_in(name), self.plan)
            for one, name in zip(given, self.names, strict=True)
        ]

    def solve(
        self, run: Run, given: Sequence[GivenRecording], found: Mapping[int, FoundPlanes]
    ) -> dict[int, Surfaces]:
        """Return the planes in each recording."""
        self.found = found
        return {i: PlaneSurfaces(given[i], one) for i, one in found.items()}

    def rows(self, written: Mapping[int, Written]) -> dict[int, dict[str, Any]]:
        """Return what was found in each recording; what contradicts a plane is counted there."""
        return {
            i: {
                'verdict': 'doubtful' if one.doubts else 'used',
                'reasons': [*one.doubts, *one.notes],
                **written[i].table(),
                'planes': one.table(),
            }
            for i, one in self.found.items()
        }

    def about(self) -> dict[str, Any]:
        """Return what was known of the planes."""
        return {
            'planes': str(self.request.planes),
            'origin_m': list(self.plan.origin),
            'room_error_mm': self.request.room_error * 1e3,
        }

    def findings(self) -> dict[str, Any]:
        """Return what the planes cannot decide, and what they hide."""
        absent = sorted(set(self.plan.changes) - set(self.names))
        found = self.found.values()
        taped = [any(one.taped) for one in found]
        open_ = hidden_by_planes(any(taped), any(one.square for one in found))
        if all(one.frontal < _FRONTAL for one in found):
            reason = (
                'all recordings show one wall from the front; views tilted by 40 degrees, and the '
                'distance of each, would decide it'
            )
            open_.append({'effect': 'wiggling', 'reason': reason})
        return {
            **({'not_given': absent} if absent else {}),
            'cannot_decide': open_,  # The diagnosis computes others for each recording.
            'absorbed': absorbed('tape' if all(taped) else 'planes'),
        }


def asked_for(request: TruthRequest) -> str:
    """
    Return what should be measured before the work: the distance of planes; or nothing.

    Raises `InputError` when the file of the planes cannot be used.
    """
    if not isinstance(request, PlaneRequest):
        return ''
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

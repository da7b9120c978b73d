"""Place the planes of one recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.clean import Clean, KNOWN, OUTSIDE
from flexx2_sim_ros.truth.files import reason_of
from flexx2_sim_ros.truth.observation import Footage, Observation, observe
from flexx2_sim_ros.truth.plane_constraints import (
    Constraints,
    contradiction,
    doubts_of,
    PlacedPlanes,
    settle,
    turned,
    turns,
)
from flexx2_sim_ros.truth.plane_file import Angle, PlaneHint
from flexx2_sim_ros.truth.plane_finding import find_planes, ImagePlane
from flexx2_sim_ros.truth.writing import PageImages, picture_of
import numpy as np


@dataclass(frozen=True)
class PlaneJob:
    """
    Planes to find in a recording.

    Attributes
    ----------
    path : pathlib.Path
    hints : tuple of PlaneHint
        The planes in the recording.
    angles : tuple of Angle
        Angles between planes, including planes that are not in view.
    origin : tuple of float
        Origin of the distances, optical frame, metres.
    camera : str or None
    profile : Profile or None
    motion : str
    room_error : float
        Standard deviation of surfaces whose flatness is not given, metres.

    """

    path: Path
    hints: tuple[PlaneHint, ...]
    angles: tuple[Angle, ...]
    origin: tuple[float, float, float]
    camera: str | None
    profile: Profile | None
    motion: str
    room_error: float


@dataclass(frozen=True)
class Nominal:
    """
    The planes of a recording.

    Attributes
    ----------
    surfaces : tuple of ImagePlane
        The planes as fitted to the recording.
    placed : PlacedPlanes
        The planes moved to the measurements.
    covariance : numpy.ndarray
        (3 P, 3 P) covariance, as in recordings.

    """

    surfaces: tuple[ImagePlane, ...]
    placed: PlacedPlanes
    covariance: np.ndarray


@dataclass(frozen=True)
class Judged:
    """
    Whether a recording's planes can be trusted.

    Attributes
    ----------
    state : str
        ``used``, ``doubtful`` or ``refused``.
    reasons : tuple of str
        Why the recording is doubtful or refused, and notes on missing measurements.
    planes : Nominal or None
        None if the recording is refused.
    taped : tuple of bool
        Of which of them a distance was measured.
    square : bool
        Whether an angle between two of them was measured.

    """

    state: str
    reasons: tuple[str, ...]
    planes: Nominal | None = None
    taped: tuple[bool, ...] = ()
    square: bool = False

    @property
    def frontal(self) -> float:
        """Return the angle between optical axis and normal of the only plane, degrees; or inf."""
        if self.planes is None or len(self.planes.surfaces) > 1:
            return float('inf')
        return float(np.degrees(np.arccos(np.clip(self.planes.placed.normals[0, 2], -1, 1))))

    def table(self) -> list[dict[str, Any]]:
        """Return the planes for ``truth.yaml``."""
        if self.planes is None:
            return []
        placed, spread = self.planes.placed, np.sqrt(np.diag(self.planes.covariance))
        distances = placed.distance_deviations(self.planes.covariance)
        return [
            {
                'name': surface.name,
                'distance_m': round(float(placed.distances[k]), 5),
                'normal': [round(float(value), 5) for value in placed.normals[k]],
                'sigma_mm': round(float(distances[k]) * 1e3, 2),
                'sigma_deg': round(float(np.degrees(spread[3 * k + 1 : 3 * k + 3].max())), 3),
                'residual_mm': _off(surface, placed, k) if told else None,
                'bend_mm': round(surface.bend * 1e3, 2),
            }
            for k, (surface, told) in enumerate(zip(self.planes.surfaces, self.taped, strict=True))
        ]


def _off(surface: ImagePlane, placed: PlacedPlanes, k: int) -> float:
    return round((surface.distance - float(placed.distances[k])) * 1e3, 2)


def place_planes(job: PlaneJob) -> Judged:
    """Find the planes of a recording and move them to the measurements."""
    try:
        reader = open_recording(job.path, job.camera, job.profile)
        footage = observe(reader, job.profile, job.motion)
    except InputError as error:  # The others can be used.
        return Judged('refused', (reason_of(error, job.path),))
    if footage.moving:
        return Judged('refused', ('the camera moves; planes need one that stands still',))
    surfaces = find_planes(footage.still, job.hints)
    names = [surface.name for surface in surfaces]
    missing = [hint for hint in job.hints if hint.name not in names]
    for hint in missing:
        if hint.box or hint.outline:
            return Judged('refused', (f'{hint.name}: no plane is found where the file says',))
    if not surfaces:
        return Judged('refused', ('no plane is found in it',))
    constraints = _constraints(job, names)
    reason = turned(surfaces, constraints)
    if reason:
        return Judged('refused', (reason,))
    placed, covariance = settle(_fitted(surfaces, footage.still), constraints)
    reason = contradiction(placed, constraints)
    if reason:
        return Judged('refused', (reason,))
    doubts = doubts_of(surfaces, constraints)
    notes = turns(surfaces, constraints)
    notes += [f'{hint.name}: not found' for hint in missing]
    notes += [note for surface in surfaces for note in surface.notes()]
    return Judged(
        'doubtful' if doubts else 'used',
        tuple(doubts + notes),
        Nominal(tuple(surfaces), placed, covariance),
        tuple(told is not None for told in constraints.distances),
        bool(constraints.angles),
    )


def _constraints(job: PlaneJob, names: list[str]) -> Constraints:
    told = {hint.name: hint.distance for hint in job.hints}
    angles = tuple(a for a in job.angles if a.first in names and a.second in names)
    return Constraints(tuple(names), tuple(told[name] for name in names), angles, job.origin)


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


@dataclass(frozen=True)
class PlaneSurfaces:
    """The planes of a recording; see `Surfaces`."""

    job: PlaneJob
    planes: Nominal
    moving = False

    def at(self, footage: Footage, number: int) -> Clean:
        """Return the planes as the image shows them."""
        return _render(self.job, self.planes, footage.still)[0]

    def truths(self, footage: Footage) -> list[Clean]:
        """Return the planes of the one image."""
        return [self.at(footage, 0)]

    def accuracy(self, footage: Footage, truths: Sequence[Clean]) -> dict[str, np.ndarray]:
        """Return the plane of each pixel, and the covariance of the planes."""
        return {
            'plane': _render(self.job, self.planes, footage.still)[1],
            'plane_covariance': self.planes.covariance,
            'plane_names': np.array([surface.name for surface in self.planes.surfaces]),
        }

    def shown(
        self, footage: Footage, truths: Sequence[Clean], shares: dict[str, float]
    ) -> tuple[PageImages, Any]:
        """Return images of the median; what contradicts a plane is counted plane by plane."""
        return replace(picture_of(truths[0], footage.still, shares), notes=()), None


def _render(job: PlaneJob, planes: Nominal, image: Observation) -> tuple[Clean, np.ndarray]:
    # Pixels outside the planes are unknown.
    rays, shape = image.directions, image.depth.shape
    depth, incidence = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    sigma, plane = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    part = np.full(shape, OUTSIDE, np.uint8)
    flat = {hint.name: hint.flat for hint in job.hints}
    for k, surface in enumerate(planes.surfaces):
        mask = surface.mask
        along = rays[mask] @ planes.placed.normals[k]
        told = flat[surface.name]
        depth[mask] = planes.placed.distances[k] / along
        incidence[mask] = np.arccos(np.clip(along / image.length[mask], 0, 1))
        sigma[mask] = (job.room_error if told is None else told) / along
        plane[mask] = k + 1
        part = np.where((part == KNOWN) | (surface.part == OUTSIDE), part, surface.part)
    return Clean(depth, incidence, None, part, sigma), plane

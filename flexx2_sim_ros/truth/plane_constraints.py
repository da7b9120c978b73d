"""Move planes to measured distances and angles, with the covariance of the measurements."""

from collections.abc import Callable
from dataclasses import dataclass

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import weighted_equations
from flexx2_sim_ros.recording.truth import plane_axes
from flexx2_sim_ros.truth.plane_file import Angle, Measured
from flexx2_sim_ros.truth.plane_finding import ImagePlane
import numpy as np

# Standard deviations of a plane without measurements: metres, radians. They are large, because a
# plane that is fitted to the recording contains the errors of the camera.
FREE_OFFSET, FREE_TILT = 0.1, np.radians(5.0)
# What is measured with a tool stands above what the camera shows: however far it is, the plane
# follows. A recording shows the tilt of a plane better than its distance, so planes are moved to a
# measured distance, not turned.
_FITTED_TILT = np.radians(0.3)
_GIVES_WAY = 1e-6
_PARALLEL = np.radians(3.0)  # from 0 or 180 degrees
_MOST_TURN = 10.0  # degrees by which errors of the camera turn a plane
_CONTRADICTION = 5.0  # standard deviations
# Metres, root mean square: effects of usual strength bend a plane by at most 0.006 (python -m
# bench.planes), two walls taken for one by 0.017 to 0.035.
_MOST_BEND = 0.015
# Metres by which an offset and bounced light may change a distance.
_MOST_OFFSET = 0.1
_ITERATIONS = 8
_STEP = 1e-6


@dataclass(frozen=True)
class PlacedPlanes:
    """P planes of one recording, in the optical frame."""

    normals: np.ndarray  # (P, 3) unit normals that point away from the camera
    distances: np.ndarray  # (P,) metres from the optical centre, perpendicular
    pivots: np.ndarray  # (P, 3) metres, points about which tilts turn the planes

    def moved(self, change: np.ndarray) -> 'PlacedPlanes':
        """Return the planes moved: (3 P,) an offset (metres) and two tilts (radians) of each."""
        normals, distances = self.normals.copy(), self.distances.copy()
        for k, (offset, *tilts) in enumerate(change.reshape(-1, 3)):
            normal = self.normals[k]
            turned = normal + np.cross(np.array(tilts) @ np.stack(plane_axes(normal)), normal)
            normals[k] = turned / np.linalg.norm(turned)
            distances[k] = normals[k] @ (self.pivots[k] + offset * normal)
        pivots = self.pivots + (distances - (normals * self.pivots).sum(axis=1))[:, None] * normals
        return PlacedPlanes(normals, distances, pivots)

    def distance_deviations(self, covariance: np.ndarray) -> np.ndarray:
        """Return (P,) standard deviations of `distances`, by a (3 P, 3 P) covariance, metres."""
        slope = _slope(lambda change: self.moved(change).distances, np.zeros(len(covariance)))
        return np.asarray(np.sqrt(np.einsum('pi,ij,pj->p', slope, covariance, slope)))


@dataclass(frozen=True)
class Constraints:
    """The measurements of the P planes of one recording."""

    names: tuple[str, ...]
    distances: tuple[Measured | None, ...]  # metres from `origin`
    angles: tuple[Angle, ...]
    origin: tuple[float, float, float]  # optical frame, metres

    def errors(self, placed: PlacedPlanes) -> tuple[np.ndarray, list[str]]:
        """Return (C,) errors of planes, in standard deviations, and what each was measured of."""
        errors, words = [], []
        away = placed.distances - placed.normals @ np.array(self.origin)
        for name, found, told in zip(self.names, away, self.distances, strict=True):
            if told is not None:
                errors.append((found - told.value) / told.deviation)
                words.append(f'distance of {name}')
        for angle in self.angles:
            first, second = (self.names.index(name) for name in (angle.first, angle.second))
            told = np.radians(angle.degrees.value)
            parts = _angle_errors(placed.normals[first], placed.normals[second], told)
            errors += list(parts / np.radians(angle.degrees.deviation))
            words += [f'angle between {angle.first} and {angle.second}'] * len(parts)
        return np.array(errors), words


def _seen_angle(one: np.ndarray, other: np.ndarray) -> float:
    # The angle between two planes on the camera's side, radians, from their normals.
    across = float(np.linalg.norm(np.cross(one, other)))
    return float(np.pi - np.arctan2(across, one @ other))


def _angle_errors(one: np.ndarray, other: np.ndarray, told: float) -> np.ndarray:
    # The angle itself has no derivative where planes are parallel.
    if min(told, np.pi - told) > _PARALLEL:
        return np.array([_seen_angle(one, other) - told])
    return np.asarray(np.stack(plane_axes(one)) @ other)


def settle(placed: PlacedPlanes, constraints: Constraints) -> tuple[PlacedPlanes, np.ndarray]:
    """
    Move planes, as fitted to a recording, to the measurements, by generalised least squares.

    Return them and the (3 P, 3 P) covariance of their parameters, by the measurements alone: those
    without have `FREE_OFFSET` and `FREE_TILT`.
    """

    def errors(planes: PlacedPlanes) -> Callable[[np.ndarray], np.ndarray]:
        return lambda change: constraints.errors(planes.moved(change))[0]

    count = len(placed.distances)
    stiff = _GIVES_WAY * np.tile([FREE_OFFSET, _FITTED_TILT, _FITTED_TILT], count) ** -2.0
    change = np.zeros(len(stiff))
    for _ in range(_ITERATIONS):
        slope, left = _slope(errors(placed), change), errors(placed)(change)
        normal, right = weighted_equations(slope.T, np.ones(len(left)), left)
        change = change - np.linalg.solve(normal + np.diag(stiff), right + stiff * change)
    moved = placed.moved(change)
    free = np.tile([FREE_OFFSET, FREE_TILT, FREE_TILT], count) ** -2.0
    # The parameters are relative to the present planes.
    slope = _slope(errors(moved), np.zeros(len(stiff)))
    covariance = np.linalg.inv(np.diag(free) + slope.T @ slope)
    return moved, (covariance + covariance.T) / 2


def _slope(values: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> np.ndarray:
    columns = [values(at + step) - values(at - step) for step in _STEP * np.eye(len(at))]
    return np.stack(columns, axis=1) / (2 * _STEP)


def turned(surfaces: list[ImagePlane], constraints: Constraints) -> list[str]:
    """
    Return notes on where a recording shows other angles than were measured.

    Raises `InputError` where one is so far off that the file means other planes.
    """
    normals = {surface.name: surface.normal for surface in surfaces}
    notes = []
    for angle in constraints.angles:
        told = angle.degrees
        seen = float(np.degrees(_seen_angle(normals[angle.first], normals[angle.second])))
        off, least = abs(seen - told.value), _CONTRADICTION * told.deviation
        if off > 2 * _MOST_TURN + least:
            raise InputError(
                f'the angle between {angle.first} and {angle.second} must be that of the planes '
                f'found, {seen:.0f} degrees, got {told.value:g}'
            )
        if off > least:
            notes.append(
                f'{angle.first} and {angle.second}: the recording shows {seen:.1f} degrees '
                f'between them, {told.value:g} +- {told.deviation:g} were measured and count'
            )
    return notes


def check_agreement(placed: PlacedPlanes, constraints: Constraints) -> None:
    """Raise `InputError` where measurements contradict each other."""
    errors, words = constraints.errors(placed)
    worst, what = max(zip(np.abs(errors).tolist(), words, strict=True), default=(0.0, ''))
    if worst > _CONTRADICTION:
        raise InputError(
            f'the {what} must agree with the other measurements, got one that is {worst:.0f} '
            'standard deviations off'
        )


def doubts_of(surfaces: list[ImagePlane], constraints: Constraints) -> list[str]:
    """Return why the planes of a recording are doubtful."""
    doubts = [
        f'{surface.name}: the recording bends it by {surface.bend * 1e3:.0f} mm rms: several '
        'surfaces (give the outline of one), or an error of the camera'
        for surface in surfaces
        if surface.bend > _MOST_BEND
    ]
    for surface, told in zip(surfaces, constraints.distances, strict=True):
        if told is None:
            continue
        seen = surface.distance - float(surface.normal @ np.array(constraints.origin))
        if abs(seen - told.value) > _MOST_OFFSET + _CONTRADICTION * told.deviation:
            doubts.append(
                f'{surface.name}: the recording shows it at {seen:.2f} m, the file says '
                f'{told.value:g} m, which is more than an offset can be'
            )
    return doubts

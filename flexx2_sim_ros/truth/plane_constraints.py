"""Move planes to measured distances and angles, with the covariance of the measurements."""

from collections.abc import Iterator
from dataclasses import dataclass

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
    """
    Planes of one recording.

    Attributes
    ----------
    normals : numpy.ndarray
        (P, 3) unit normals that point away from the camera, optical frame.
    distances : numpy.ndarray
        (P,) metres from the optical centre, perpendicular.
    pivots : numpy.ndarray
        (P, 3) metres: points about which tilts turn the planes.

    """

    normals: np.ndarray
    distances: np.ndarray
    pivots: np.ndarray

    def moved(self, change: np.ndarray) -> 'PlacedPlanes':
        """
        Return the planes moved.

        Parameters
        ----------
        change : numpy.ndarray
            (3 P,) an offset in metres and two tilts in radians for each plane, as in recordings.

        """
        normals, distances = self.normals.copy(), self.distances.copy()
        for k, (offset, *tilts) in enumerate(change.reshape(-1, 3)):
            normal = self.normals[k]
            turned = normal + np.cross(np.array(tilts) @ np.stack(plane_axes(normal)), normal)
            normals[k] = turned / np.linalg.norm(turned)
            distances[k] = normals[k] @ (self.pivots[k] + offset * normal)
        pivots = self.pivots + (distances - (normals * self.pivots).sum(axis=1))[:, None] * normals
        return PlacedPlanes(normals, distances, pivots)

    def distance_deviations(self, covariance: np.ndarray) -> np.ndarray:
        """
        Return the (P,) standard deviations of `distances`, metres.

        Parameters
        ----------
        covariance : numpy.ndarray
            (3 P, 3 P) of the planes' parameters. A tilt turns a plane about its pivot and so
            changes its distance.

        """
        out = np.empty(len(self.distances))
        for k, (normal, pivot) in enumerate(zip(self.normals, self.pivots, strict=True)):
            tilts = [np.cross(axis, normal) @ pivot for axis in plane_axes(normal)]
            change = np.array([1.0, *tilts])
            own = slice(3 * k, 3 * k + 3)
            out[k] = np.sqrt(change @ covariance[own, own] @ change)
        return out


@dataclass(frozen=True)
class Constraints:
    """
    The measurements of the planes of one recording.

    Attributes
    ----------
    names : tuple of str
        Names of the P planes.
    distances : tuple of Measured or None
        Distance of each plane, metres from the origin.
    angles : tuple of Angle
        Angles between them.
    origin : tuple of float
        Origin of the distances, optical frame, metres.

    """

    names: tuple[str, ...]
    distances: tuple[Measured | None, ...]
    angles: tuple[Angle, ...]
    origin: tuple[float, float, float]

    def errors(self, placed: PlacedPlanes) -> tuple[np.ndarray, list[str]]:
        """
        Return the differences between planes and measurements.

        Parameters
        ----------
        placed : PlacedPlanes
            The planes.

        Returns
        -------
        tuple
            (C,) differences in standard deviations, and the description of each.

        """
        errors, words = [], []
        for name, found, told in zip(
            self.names, self.tape_errors(placed), self.distances, strict=True
        ):
            if told is not None:
                errors.append(found / told.deviation)
                words.append(f'distance of {name}')
        for angle in self.angles:
            one, other = (
                placed.normals[self.names.index(name)] for name in (angle.first, angle.second)
            )
            parts = _angle_errors(one, other, np.radians(angle.degrees.value))
            errors += list(parts / np.radians(angle.degrees.deviation))
            words += [f'angle between {angle.first} and {angle.second}'] * len(parts)
        return np.array(errors), words

    def tape_errors(self, placed: PlacedPlanes) -> np.ndarray:
        """Return (P,) distance minus measured distance, metres; NaN if not measured."""
        told = np.array([np.nan if d is None else d.value for d in self.distances])
        return np.asarray(placed.distances - placed.normals @ np.array(self.origin) - told)


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
    Move planes to the measurements, by generalised least squares.

    Parameters
    ----------
    placed : PlacedPlanes
        The planes as fitted to the recording.
    constraints : Constraints
        What was measured.

    Returns
    -------
    tuple
        The moved planes, and the (3 P, 3 P) covariance of their parameters. The covariance comes
        from the measurements alone; parameters without a measurement have `FREE_OFFSET` and
        `FREE_TILT`.

    """
    count = len(placed.distances)
    stiff = _GIVES_WAY * np.tile([FREE_OFFSET, _FITTED_TILT, _FITTED_TILT], count) ** -2.0
    change = np.zeros(len(stiff))
    for _ in range(_ITERATIONS):
        slope, errors = _slope(placed, change, constraints), _errors(placed, change, constraints)
        normal = np.diag(stiff) + slope.T @ slope
        change = change - np.linalg.solve(normal, stiff * change + slope.T @ errors)
    moved = placed.moved(change)
    free = np.tile([FREE_OFFSET, FREE_TILT, FREE_TILT], count) ** -2.0
    # The parameters are relative to the present planes.
    slope = _slope(moved, np.zeros(len(stiff)), constraints)
    covariance = np.linalg.inv(np.diag(free) + slope.T @ slope)
    return moved, (covariance + covariance.T) / 2


def _errors(placed: PlacedPlanes, change: np.ndarray, constraints: Constraints) -> np.ndarray:
    return constraints.errors(placed.moved(change))[0]


def _slope(placed: PlacedPlanes, change: np.ndarray, constraints: Constraints) -> np.ndarray:
    columns = [
        _errors(placed, change + step, constraints) - _errors(placed, change - step, constraints)
        for step in _STEP * np.eye(len(change))
    ]
    return np.stack(columns, axis=1) / (2 * _STEP)


def _angles(
    surfaces: list[ImagePlane], constraints: Constraints
) -> Iterator[tuple[Angle, float, float]]:
    # Each measured angle, what the recording shows, and how far that is off: degrees.
    normals = {surface.name: surface.normal for surface in surfaces}
    for angle in constraints.angles:
        seen = float(np.degrees(_seen_angle(normals[angle.first], normals[angle.second])))
        yield angle, seen, abs(seen - angle.degrees.value)


def turned(surfaces: list[ImagePlane], constraints: Constraints) -> str:
    """Return why a recording shows other planes than the file means, or nothing."""
    for angle, seen, off in _angles(surfaces, constraints):
        if off > 2 * _MOST_TURN + _CONTRADICTION * angle.degrees.deviation:
            return (
                f'the angle between {angle.first} and {angle.second} must be that of the planes '
                f'found, {seen:.0f} degrees, got {angle.degrees.value:g}'
            )
    return ''


def turns(surfaces: list[ImagePlane], constraints: Constraints) -> list[str]:
    """Return where the recording shows another angle than was measured: a finding."""
    return [
        f'{angle.first} and {angle.second}: the recording shows {seen:.1f} degrees between them, '
        f'{angle.degrees.value:g} +- {angle.degrees.deviation:g} were measured and count'
        for angle, seen, off in _angles(surfaces, constraints)
        if off > _CONTRADICTION * angle.degrees.deviation
    ]


def contradiction(placed: PlacedPlanes, constraints: Constraints) -> str:
    """Return which measurements contradict each other, or nothing."""
    errors, words = constraints.errors(placed)
    if not len(errors) or np.abs(errors).max() <= _CONTRADICTION:
        return ''
    worst = int(np.abs(errors).argmax())
    return (
        f'the {words[worst]} must agree with the other measurements, got one that is '
        f'{abs(errors[worst]):.0f} standard deviations off'
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

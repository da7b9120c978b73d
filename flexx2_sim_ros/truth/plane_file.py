"""`planes.yaml`: where planes of a room are in recordings, and what was measured of them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import json
from pathlib import Path
import re
from typing import Any

from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.profiles.section import is_number

_KEYS = {'schema', 'origin', 'planes', 'recordings'}
PLACES = 'seed', 'box', 'outline'  # of which one is given
_OF_RECORDING = {*PLACES, 'distance'}
_OF_PLANE = {*_OF_RECORDING, 'name', 'angles', 'flat'}
BLANK = '___'  # stands in a form for what is not filled in
_FORM = f"""\
# Write what you measure in place of {BLANK}. What stays {BLANK} counts as not measured.
#   distance  of the plane from the camera's front, perpendicular to it, metres: 1.203 +- 0.003
#   box       [left, top, right, bottom]: pixels on the plane, where it is not the largest one
# A plane that a recording does not show: null. Recordings that are not there are ignored.
schema: 1
origin: 0  # metres from the optical centre to the camera's front
"""
_MOST_PLANES, _MOST_CORNERS, _LONGEST_NAME = 20, 100, 60
# Standard deviation of a measurement that is given without one: metres, degrees.
_TAPE, _SQUARE = 0.005, 0.5
_NEAREST, _FARTHEST, _MOST_ERROR = 0.05, 20.0, 1.0  # metres
_NUMBER = r'([+-]?\d*\.?\d+(?:[eE][+-]?\d+)?)'
_MEASURED = re.compile(rf'\s*{_NUMBER}\s*(?:(?:\+-|\+/-|±)\s*{_NUMBER}\s*)?')


@dataclass(frozen=True)
class Measured:
    """A measurement and its standard deviation, in metres or degrees."""

    value: float
    deviation: float


@dataclass(frozen=True)
class PlaneHint:
    """How to find a plane in a recording, and its measurements."""

    name: str
    # Left, top, right, bottom pixel of a part of it; empty if it is found by its size.
    box: tuple[float, ...] = ()
    distance: Measured | None = None  # perpendicular, from the origin, metres
    flat: float | None = None  # standard deviation of the surface, metres
    # Corners of the whole plane, pixels; empty if the recording shows its borders.
    outline: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Angle:
    """An angle between two planes, on the camera's side: 180 degrees where they are one flat."""

    first: str  # name of a plane
    second: str
    degrees: Measured


@dataclass(frozen=True)
class PlaneFile:
    """The content of ``planes.yaml``."""

    planes: tuple[PlaneHint, ...]
    angles: tuple[Angle, ...]
    origin: tuple[float, float, float]  # of the distances, optical frame, metres
    # By the name of a recording without suffix, then of a plane; None if it is not in view.
    changes: Mapping[str, Mapping[str, PlaneHint | None]]

    def seen_in(self, recording: str) -> tuple[PlaneHint, ...]:
        """Return the planes of a recording, by its name without the suffix."""
        changes = self.changes.get(recording, {})
        hints = [changes.get(plane.name, plane) for plane in self.planes]
        return tuple(hint for hint in hints if hint is not None)


def plane_form(seen: Mapping[str, Mapping[str, str]]) -> str:
    """
    Return the text of a ``planes.yaml`` to be filled in.

    `seen` has what was planned, by the name of a recording, then of a plane that it shows.
    """
    names = list(dict.fromkeys(name for planes in seen.values() for name in planes))
    lines = ['planes:', *(f'- name: {name}' for name in names), 'recordings:']
    for recording, planes in seen.items():
        lines.append(f'  {json.dumps(recording)}:')
        for name in names:
            blank = f'{{distance: {BLANK}, box: {BLANK}}}'
            about = f'  # {planes[name]}' if planes.get(name) else ''
            lines.append(f'    {name}: {blank}{about}' if name in planes else f'    {name}: null')
    return _FORM + '\n'.join([*lines, ''])


def read_planes(path: Path) -> PlaneFile:
    """
    Read ``planes.yaml``; docs/truth.md has its keys.

    Raises `InputError` when the file cannot be read, or has an unknown key or plane or an
    impossible value; the message names file and key.
    """
    content = read_config(path)
    try:
        _check_keys('', content, _KEYS)
        rows = content.get('planes')
        good = isinstance(rows, list) and 0 < len(rows) <= _MOST_PLANES
        _check(good, 'planes', f'be a list of 1 to {_MOST_PLANES} planes', rows)
        planes = [_plane(f'planes[{i}]', row) for i, row in enumerate(content['planes'])]
        names = [plane.name for plane in planes]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise InputError(f'planes[{i}]: name: must be unique, got {shown(name)} twice')
        return PlaneFile(
            tuple(planes),
            _angles(content['planes'], names),
            _origin(content.get('origin', 0.0)),
            _changes(content.get('recordings', {}), planes),
        )
    except InputError as error:
        raise InputError(f'{shown_path(path)}: {error}') from error


def _check(good: bool, field: str, required: str, value: Any) -> None:
    if not good:
        raise InputError(f'{field}: must {required}, got {shown(value)}')


def _check_keys(field: str, found: Any, known: set[str]) -> None:
    where = f'{field}: ' if field else ''
    if not isinstance(found, dict):
        raise InputError(f'{where}must be a mapping, got {shown(found)}')
    for key in found:
        if key not in known:
            raise InputError(
                f'{where}must have the keys {", ".join(sorted(known))} only, got {shown(key)}'
            )


def _plane(field: str, row: Any) -> PlaneHint:
    _check_keys(field, row, _OF_PLANE)
    name, flat = row.get('name'), row.get('flat')
    good = isinstance(name, str) and 0 < len(name) <= _LONGEST_NAME and name.isprintable()
    _check(good, f'{field}: name', f'be a text of 1 to {_LONGEST_NAME} letters', name)
    good = flat is None or is_number(flat) and 0 <= flat <= _MOST_ERROR
    _check(good, f'{name}: flat', f'be metres, 0 to {_MOST_ERROR:g}', flat)
    return _hint(name, PlaneHint(name, flat=flat), row)


def _hint(field: str, plane: PlaneHint, row: Mapping[str, Any]) -> PlaneHint:
    # The plane with the changes of a mapping.
    row = {key: value for key, value in row.items() if value not in (None, BLANK)}
    given = [place for place in PLACES if place in row]
    if len(given) > 1:
        raise InputError(f'{field}: must have one of {", ".join(PLACES)}, got {", ".join(given)}')
    if 'outline' in row:
        plane = replace(plane, box=(), outline=_outline(f'{field}: outline', row['outline']))
    elif 'seed' in row:
        pixel = _numbers(f'{field}: seed', row['seed'], 'a pixel [u, v]', 2)
        plane = replace(plane, box=pixel * 2, outline=())
    elif 'box' in row:
        plane = replace(plane, box=_box(f'{field}: box', row['box']), outline=())
    if 'distance' in row:
        plane = replace(plane, distance=_distance(f'{field}: distance', row['distance']))
    return plane


def _box(field: str, value: Any) -> tuple[float, ...]:
    box = _numbers(field, value, 'pixels [left, top, right, bottom]', 4)
    required = 'be [left, top, right, bottom] with left <= right and top <= bottom'
    _check(box[0] <= box[2] and box[1] <= box[3], field, required, list(box))
    return box


def _outline(field: str, value: Any) -> tuple[tuple[float, ...], ...]:
    good = isinstance(value, list) and 3 <= len(value) <= _MOST_CORNERS
    _check(good, field, f'be a list of 3 to {_MOST_CORNERS} corners [u, v]', value)
    return tuple(_numbers(field, corner, 'corners [u, v] in pixels', 2) for corner in value)


def _distance(field: str, value: Any) -> Measured:
    found, required = _measured(field, value, _TAPE), f'be metres, {_NEAREST:g} to {_FARTHEST:g}'
    if found.value > _FARTHEST:
        raise InputError(
            f'{field}: must {required}, got {found.value:g}; it looks like millimetres'
        )
    good = found.value >= _NEAREST and 0 < found.deviation <= _MOST_ERROR
    more = f'with a standard deviation above 0 and up to {_MOST_ERROR:g}'
    _check(good, field, f'{required}, {more}', value)
    return found


def _angles(rows: list[dict[str, Any]], names: list[str]) -> tuple[Angle, ...]:
    out: dict[frozenset[str], Angle] = {}
    for row, name in zip(rows, names, strict=True):
        angles = row.get('angles', {})
        _check_keys(f'{name}: angles', angles, set(names) - {name})
        for other, value in angles.items():
            field = f'{name}: angles: {other}'
            found = _measured(field, value, _SQUARE)
            good = 0 <= found.value <= 180 and 0 < found.deviation <= 90
            _check(good, field, 'be degrees, 0 to 180, with a standard deviation above 0', value)
            before = out.setdefault(frozenset((name, other)), Angle(name, other, found))
            if before.degrees != found:
                raise InputError(
                    f'{field}: must be the same in both planes, got {found.value:g} and '
                    f'{before.degrees.value:g} degrees'
                )
    return tuple(out.values())


def _origin(value: Any) -> tuple[float, float, float]:
    ahead = [0.0, 0.0, value] if is_number(value) else value
    x, y, z = _numbers('origin', ahead, 'metres ahead of the optical centre, or [x, y, z]', 3)
    required = f'be metres, at most {_MOST_ERROR:g} from the optical centre'
    _check(max(abs(x), abs(y), abs(z)) <= _MOST_ERROR, 'origin', required, value)
    return x, y, z


def _changes(given: Any, planes: list[PlaneHint]) -> dict[str, dict[str, PlaneHint | None]]:
    by_name = {plane.name: plane for plane in planes}
    _check(isinstance(given, dict), 'recordings', 'be a mapping', given)
    out: dict[str, dict[str, PlaneHint | None]] = {}
    for recording, rows in given.items():
        field = f'recordings: {shown(recording)}'
        if not isinstance(recording, str):
            raise InputError(f'{field}: must be the name of a recording')
        _check_keys(field, rows, set(by_name))
        mine = out.setdefault(recording.removesuffix('.npz'), {})
        for name, row in rows.items():
            mine[name] = None
            if row is not None:
                _check_keys(f'{field}: {name}', row, _OF_RECORDING)
                mine[name] = _hint(f'{field}: {name}', by_name[name], row)
    return out


def _measured(field: str, value: Any, usual: float) -> Measured:
    # A number, or a text such as `1.20 +- 0.01`.
    if is_number(value):
        return Measured(float(value), usual)
    match = _MEASURED.fullmatch(value) if isinstance(value, str) and len(value) < 80 else None
    if match is None:
        raise InputError(f'{field}: must be a number, or text as 1.20 +- 0.01, got {shown(value)}')
    number, deviation = match.groups()
    return Measured(float(number), usual if deviation is None else float(deviation))


def _numbers(field: str, value: Any, wanted: str, count: int) -> tuple[float, ...]:
    good = isinstance(value, list) and len(value) == count and all(map(is_number, value))
    _check(good, field, f'be {wanted}', value)
    return tuple(map(float, value))

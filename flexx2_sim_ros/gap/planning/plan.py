"""The plan of a measuring session: what to record, from a YAML file."""

from dataclasses import dataclass
from pathlib import Path
import re
from typing import Any

from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.gap.planning.scenes import card, PlannedScene, wall
from flexx2_sim_ros.limits import is_finite
from flexx2_sim_ros.paths import config_dir

_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9_-]{0,60}')
_MOST_RECORDINGS = 60
# Names and bounds of the numbers that describe a wall and a card.
_WALL = (('distance', 0.05, 100.0), ('tilt', -85.0, 85.0), ('reflectivity', 0.01, 1.0))
_CARD = (
    ('distance', 0.05, 100.0),
    ('x', -50.0, 50.0),
    ('half side', 0.01, 20.0),
    ('reflectivity', 0.01, 1.0),
    ('speed', -10.0, 10.0),
)
_NUMBERS = {'seconds': (0.5, 600.0), 'after_s': (0.0, 1e5), 'pan_deg_s': (-200.0, 200.0)}


@dataclass(frozen=True)
class PlannedRecording:
    """
    One recording of a plan; `name` is that of the bag.

    `title` is a few words, `set_up` what to do, `seconds` the duration; `effects` names the
    effects that the recording shows.
    """

    name: str
    scene: PlannedScene
    title: str
    set_up: str
    seconds: float
    effects: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """
    What to record: at least two recordings of one mode, in the order of recording.

    The title is one line. `scale` is the size of the simulated image as a fraction of the
    camera's; each recording has so many simulated `frames`.
    """

    title: str
    usecase: str
    scale: float
    frames: int
    recordings: tuple[PlannedRecording, ...]


def read_plan(path: Path | None = None) -> Plan:
    """
    Read a plan, a YAML file like ``config/gap_plan.yaml``, which describes each key.

    That file is read if none is given. Raises `InputError` when the file is not a plan; the
    message names the file, the recording and the key.
    """
    path = path or config_dir() / 'gap_plan.yaml'
    table = read_config(path)
    try:
        return _plan(table)
    except InputError as error:
        raise InputError(f'{shown_path(path)}: {error}') from error


def _plan(table: dict[str, Any]) -> Plan:
    rows = table.get('recordings')
    if not isinstance(rows, list) or not 2 <= len(rows) <= _MOST_RECORDINGS:
        raise InputError(f'recordings: must be a list of 2 to {_MOST_RECORDINGS}')
    simulation = table.get('simulation', {})
    if not isinstance(simulation, dict):
        raise InputError(f'simulation: must be a mapping, got {shown(simulation)}')
    recordings = []
    for i, row in enumerate(rows, 1):
        try:
            recordings.append(_recording(row))
        except InputError as error:
            raise InputError(f'recording {i}: {error}') from error
    names = [one.name for one in recordings]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f'name: must be unique, got {name} twice')
    return Plan(
        _text(table, 'title'),
        _text(table, 'usecase'),
        _number('simulation: scale', simulation.get('scale', 0.5), 0.1, 1.0),
        int(_number('simulation: frames', simulation.get('frames', 10), 6, 48)),
        tuple(recordings),
    )


def _recording(row: Any) -> PlannedRecording:
    if not isinstance(row, dict):
        raise InputError(f'must be a mapping, got {shown(row)}')
    name = _text(row, 'name')
    if not _NAME.fullmatch(name):
        raise InputError(f'name: must be letters, digits, _ and -, got {shown(name)}')
    seconds, after, pan = (
        _number(key, row.get(key, 0.0), *bounds) for key, bounds in _NUMBERS.items()
    )
    effects = row.get('for')
    if not isinstance(effects, list) or not effects:
        raise InputError(f'for: must be a list of effects, got {shown(effects)}')
    for effect in effects:
        if not isinstance(effect, str) or effect not in registry():
            raise InputError(f'for: must be among {", ".join(registry())}, got {shown(effect)}')
    panels = [wall(*numbers) for numbers in _lists(row, 'walls', _WALL)]
    panels += [
        card(distance, x, half, reflectivity, (speed, 0.0, 0.0))
        for distance, x, half, reflectivity, speed in _lists(row, 'cards', _CARD)
    ]
    if not panels:
        raise InputError('walls: must be at least one wall or card, got none')
    set_up = ' '.join(_text(row, 'set_up').split())
    scene = PlannedScene(tuple(panels), pan, after)
    return PlannedRecording(name, scene, _text(row, 'title'), set_up, seconds, tuple(effects))


def _lists(
    row: dict[str, Any], key: str, bounds: tuple[tuple[str, float, float], ...]
) -> list[list[float]]:
    found = row.get(key, [])
    if not isinstance(found, list) or len(found) > 20:
        raise InputError(f'{key}: must be a list of at most 20, got {shown(found)}')
    out = []
    for one in found:
        if not isinstance(one, list) or len(one) != len(bounds):
            names = ', '.join(name for name, _, _ in bounds)
            raise InputError(f'{key}: must be [{names}], got {shown(one)}')
        pairs = zip(one, bounds, strict=True)
        out.append([_number(f'{key}: {name}', v, low, high) for v, (name, low, high) in pairs])
    return out


def _number(name: str, value: Any, low: float, high: float) -> float:
    if not (is_finite(value) and low <= value <= high):
        raise InputError(f'{name}: must be {low:g} to {high:g}, got {shown(value)}')
    return float(value)


def _text(row: dict[str, Any], key: str) -> str:
    value = row.get(key)
    if not isinstance(value, str) or not value.strip():
        raise InputError(f'{key}: must be a text, got {shown(value)}')
    return value

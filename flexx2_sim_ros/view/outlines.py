"""Outlines of planes that are drawn on images, in ``planes.yaml``."""

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros import atomic
from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.truth.plane_file import PLACES, read_planes
import yaml

_EMPTY = 'schema: 1\nplanes: []\n'


def drawn(path: Path, names: Sequence[str]) -> dict[str, Any]:
    """Return the names of planes, and their outlines in recordings of these names."""
    plan = read_planes(path) if path.exists() else None
    return {
        'names': [] if plan is None else [plane.name for plane in plan.planes],
        'outlines': [
            {} if plan is None else {one.name: one.outline for one in plan.seen_in(name)}
            for name in names
        ],
    }


def save_outline(
    path: Path, recording: str, plane: str, corners: Sequence[Sequence[float]]
) -> None:
    """
    Write an outline into ``planes.yaml``, whole or not at all; all else in the file stays.

    The file and the plane may be new; `recording` has no suffix; `corners` are pixels [u, v].
    Raises `InputError` when the file cannot be read or written, or would not be one of planes.
    """
    if path.exists():
        read_planes(path)
    text = path.read_text(encoding='utf-8') if path.exists() else _EMPTY
    content = yaml.safe_load(text)
    if plane not in [row['name'] for row in content['planes']]:
        text = _with(text, ['planes'], {'name': plane})
    found = content.get('recordings', {})
    name = next((key for key in (recording, f'{recording}.npz') if key in found), recording)
    before = found.get(name, {}).get(plane) or {}
    row = {key: value for key, value in before.items() if key not in PLACES}
    row['outline'] = [[round(one) for one in corner] for corner in corners]
    text = _with(text, ['recordings', name, plane], row)
    with atomic.whole(path) as part:
        part.write_text(text, encoding='utf-8')
        try:
            changed = read_config(part)['recordings'][name][plane]
            read_planes(part)
        except InputError as error:
            raise InputError(str(error).removeprefix(f'{shown_path(part)}: ')) from error
        if changed != row:
            raise InputError(f'{shown_path(path)}: must be YAML without tags, got others')


def _with(text: str, keys: Sequence[str], value: Mapping[str, Any]) -> str:
    # YAML with a value at a place: what is there is replaced, what is missing added. At a list it
    # is added.
    node: Any = yaml.compose(text, Loader=yaml.SafeLoader)
    for number, key in enumerate(keys):
        below = next((one for name, one in _pairs(node) if name.value == key), None)
        if below is None:
            for outer in reversed(keys[number:]):
                value = {outer: value}
            return _added(text, node, _flow(value)[1:-1])
        node = below
    if isinstance(node, yaml.SequenceNode):
        return _added(text, node, _flow(value))
    before = text[: node.start_mark.index]
    return before + ' ' * before.endswith(':') + _flow(value) + text[_end(node) :]


def _added(text: str, node: Any, entry: str) -> str:
    start = node.start_mark.index
    sequence = isinstance(node, yaml.SequenceNode)
    if node.flow_style:
        return f'{text[: start + 1]}{entry}{", " if node.value else ""}{text[start + 1 :]}'
    return f'{text[:start]}{"- " * sequence}{entry}\n{" " * node.start_mark.column}{text[start:]}'


def _pairs(node: Any) -> Sequence[tuple[Any, Any]]:
    return node.value if isinstance(node, yaml.MappingNode) else ()


def _end(node: Any) -> int:
    # Where it ends, without comments after it.
    while not isinstance(node, yaml.ScalarNode) and not node.flow_style and node.value:
        last = node.value[-1]
        node = last[1] if isinstance(last, tuple) else last
    return int(node.end_mark.index)


def _flow(value: Mapping[str, Any]) -> str:
    style: Any = {'default_flow_style': True, 'sort_keys': False, 'allow_unicode': True}
    return str(yaml.safe_dump(value, width=math.inf, **style)).strip()

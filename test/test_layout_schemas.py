"""The layouts for RViz and Foxglove have only settings that these programs know."""

import dataclasses
import json
import re
import types
import typing

from flexx2_sim_ros.paths import config_dir
import pytest

FOXGLOVE = json.loads((config_dir() / 'foxglove.json').read_text())
# The panels of Foxglove as layouts of its app name them, and the classes of its SDK.
CONFIGS = {
    '3D': 'ThreeDeeConfig',
    'Image': 'ImageConfig',
    'Teleop': 'TeleopConfig',
    'Plot': 'PlotConfig',
    'DiagnosticSummary': 'DiagnosticsSummaryConfig',
}


def foxglove_problems(layout):
    """Return what Foxglove would ignore, by the classes of its SDK."""
    layouts = pytest.importorskip('foxglove.layouts')
    found = []
    for panel, config in layout['configById'].items():
        name = panel.partition('!')[0]
        if name == 'Parameters':  # The SDK leaves its settings open.
            continue
        own = {key: value for key, value in config.items() if key != 'foxglovePanelTitle'}
        found += unlike(getattr(layouts, CONFIGS[name]), own, panel)
    return found


def unlike(kind, value, where):
    """Return what a value of JSON has that a type of the SDK does not."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        wrong = [unlike(part, value, where) for part in parts if part is not type(None)]
        return min(wrong, key=len)
    if origin is typing.Literal:
        return [] if value in parts else [f'{where}: must be one of {parts}, got {value!r}']
    if dataclasses.is_dataclass(kind):
        return unlike_class(kind, value, where)
    if origin is tuple and isinstance(value, list) and len(value) == len(parts):
        pairs = enumerate(zip(parts, value, strict=True))
        return [line for at, (part, one) in pairs for line in unlike(part, one, f'{where}[{at}]')]
    if origin is list and isinstance(value, list):
        return [line for one in value for line in unlike(parts[0], one, f'{where}[]')]
    if origin is dict and isinstance(value, dict):
        return [line for key, one in value.items() for line in unlike(parts[1], one, key)]
    wanted = (int, float) if kind is float else origin or kind
    right = isinstance(value, wanted) and (kind is bool or not isinstance(value, bool))
    return [] if right else [f'{where}: must be {kind}, got {value!r}']


def unlike_class(kind, value, where):
    """Return what an object of JSON has that a class of the SDK does not."""
    if not isinstance(value, dict):
        return [f'{where}: must be an object, got {value!r}']
    hints = typing.get_type_hints(kind)
    names = {re.sub('_(.)', lambda found: found[1].upper(), name): name for name in hints}
    found = []
    for key, one in value.items():
        if key in names:
            found += unlike(hints[names[key]], one, f'{where}.{key}')
        else:
            found.append(f'{where}: {kind.__name__} has no {key}')
    return found


def test_foxglove_knows_every_setting():
    assert foxglove_problems(FOXGLOVE) == []

"""Find and load consumers: those of this package, of other packages, and of Python files."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import EntryPoint
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import re
import sys
from typing import Any

from flexx2_sim_ros.consumers.consumer import Consumer
from flexx2_sim_ros.entry_points import entry_points
from flexx2_sim_ros.errors import InputError, shown, shown_path, unquoted

GROUP = 'flexx2_sim_ros.consumers'
BUILT_IN = {
    'height_grid': 'flexx2_sim_ros.consumers.height_grid:HeightGrid',
    'elevation_map': 'flexx2_sim_ros.consumers.elevation_map:ElevationMap',
    'occupancy_map': 'flexx2_sim_ros.consumers.occupancy_map:OccupancyMap',
    'nearest_obstacle': 'flexx2_sim_ros.consumers.obstacle:NearestObstacle',
}
_NAME = re.compile(r'[a-z][a-z0-9_]{0,39}')


@dataclass(frozen=True)
class ConsumerSource:
    """
    Where the class of a consumer is: `attribute` of `module`, a name or the path of a Python file.

    ``label`` is what it is called until it is loaded: its name, or the file and class as given.
    """

    label: str
    module: str
    attribute: str
    is_file: bool = False


def sources(
    wanted: Collection[str], leave_out: Callable[[str, BaseException], None]
) -> list[ConsumerSource]:
    """
    Return where consumers are.

    ``wanted`` are names, or files and classes such as ``my.py:Grid``. Empty: all that are
    installed. ``leave_out`` is called with the name of each installed package that cannot be read,
    and the error. Raises InputError for an unknown name or a file that does not exist.
    """
    known = {name: _from_text(name, text) for name, text in BUILT_IN.items()}
    for point in entry_points(GROUP, leave_out):
        known.setdefault(point.name, _from_point(point))
    chosen = []
    for text in dict.fromkeys(wanted) or known:  # A consumer that is named twice runs once.
        if '.py:' not in text and text not in known:
            raise InputError(
                f'consumer: must be a file and class such as my.py:Grid, or one of '
                f'{", ".join(known)}, got {shown(text)}'
            )
        chosen.append(known[text] if text in known else _file(text))
    return chosen


def _from_text(label: str, text: str) -> ConsumerSource:
    module, _, attribute = text.partition(':')
    return ConsumerSource(label, module, attribute)


def _from_point(point: EntryPoint) -> ConsumerSource:
    return _from_text(point.name, point.value)


def _file(text: str) -> ConsumerSource:
    path, _, attribute = text.rpartition(':')
    if not Path(path).is_file():
        raise InputError(f'consumer: must be a Python file that exists, got {shown_path(path)}')
    if not attribute.isidentifier():
        raise InputError(f'consumer: must name a class, as my.py:Grid does, got {shown(text)}')
    return ConsumerSource(unquoted(text), str(Path(path).resolve()), attribute, is_file=True)


def load(source: ConsumerSource) -> Consumer:
    """
    Load and create a consumer.

    Raises InputError when it does not follow the protocol; its own errors pass through.
    """
    module = _module_of_file(source.module) if source.is_file else import_module(source.module)
    kind: Any = getattr(module, source.attribute, None)
    if kind is None:
        raise InputError(f'must have {source.attribute}, got a module without it')
    consumer = kind()
    name = getattr(consumer, 'name', None)
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise InputError(f'name: must be an identifier in lower case, got {shown(name)}')
    measures = getattr(consumer, 'measures', None)
    if not (
        isinstance(measures, Mapping)
        and measures
        and all(_is_name(key) and _is_unit(unit) for key, unit in measures.items())
    ):
        raise InputError(f'measures: must be units by name of an error, got {shown(measures)}')
    for method in ('look', 'errors'):
        if not callable(getattr(consumer, method, None)):
            raise InputError(f'{method}: must be a method, got none')
    return consumer


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and bool(_NAME.fullmatch(value))


def _is_unit(value: Any) -> bool:
    return isinstance(value, str) and value.isprintable() and len(value) <= 20


def _module_of_file(path: str) -> Any:
    name = f'flexx2_consumer_{Path(path).stem}'
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f'must be a Python file, got {shown_path(path)}')
    module = module_from_spec(spec)
    sys.modules[name] = module  # Dataclasses and pickle look modules up by name.
    # The file may import modules beside it, as a script may.
    sys.path.insert(0, str(Path(path).parent))
    spec.loader.exec_module(module)
    return module

"""Find the effects there are; read and write sets of them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from importlib import import_module
from pathlib import Path
import pkgutil
import tempfile
from types import MappingProxyType
from typing import Any

from flexx2_sim_ros.effects.effect import Effect
from flexx2_sim_ros.errors import InputError
import yaml


@lru_cache(maxsize=1)
def registry() -> Mapping[str, type[Effect]]:
    """Return all effects by name, in the order of light."""
    package = import_module('flexx2_sim_ros.effects')
    for module in pkgutil.iter_modules(package.__path__):
        import_module(f'{package.__name__}.{module.name}')
    found = sorted(Effect.__subclasses__(), key=lambda kind: (kind.stage, kind.order, kind.name))
    return MappingProxyType({kind.name: kind for kind in found})


def parse_effects(table: Any, where: str = 'effects') -> tuple[Effect, ...]:
    """
    Build effects from a table of their parameters.

    Parameters
    ----------
    table : mapping
        Parameters by effect name; None or an empty table for all typical values.
    where : str
        What to call the table in errors.

    Returns
    -------
    tuple of Effect
        In the order of light.

    Raises
    ------
    InputError
        Names the effect and the parameter that cannot be used.

    """
    if not isinstance(table, Mapping):
        raise InputError(f'{where}: found {table!r}, wanted a table of effects by name')
    known = registry()
    for name in table:
        if name not in known:
            raise InputError(f'{where}: {name}: no such effect, wanted one of {", ".join(known)}')
    try:
        return tuple(known[name].from_mapping(table[name]) for name in known if name in table)
    except InputError as error:
        raise InputError(f'{where}: {error}') from error


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """
    Read a set of effects from a YAML file.

    Parameters
    ----------
    path : str or pathlib.Path
        ``schema: 1`` and ``effects:``, a table of parameters by effect name.

    Returns
    -------
    tuple of Effect
        In the order of light.

    Raises
    ------
    InputError
        When the file cannot be read or something in it cannot be used.

    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f'{path}: cannot be read as YAML: {error}') from error
    if not isinstance(content, dict) or content.get('schema') != 1 or 'effects' not in content:
        raise InputError(f'{path}: wanted a mapping with schema: 1 and effects:')
    return parse_effects(content['effects'] or {}, f'{path}: effects')


def save_effects(path: str | Path, effects: Sequence[Effect], comment: str = '') -> None:
    """
    Write a set of effects as a file that `load_effects` reads; whole or not at all.

    Parameters
    ----------
    path : str or pathlib.Path
        The file, replaced if it exists.
    effects : sequence of Effect
        What to write.
    comment : str
        Put above it, a ``#`` before each line.

    """
    path = Path(path)
    table = {effect.name: asdict(effect) for effect in effects}
    text = ''.join(f'# {line}\n' for line in comment.splitlines())
    text += yaml.safe_dump({'schema': 1, 'effects': table}, sort_keys=False)
    with tempfile.NamedTemporaryFile('w', dir=path.parent, delete=False,
                                     encoding='utf-8') as file:
        file.write(text)
    Path(file.name).chmod(0o644)
    Path(file.name).replace(path)

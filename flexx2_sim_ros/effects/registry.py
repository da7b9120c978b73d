"""Find the effects there are; read and write sets of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
import math
import os
from pathlib import Path
import pkgutil
from types import MappingProxyType
from typing import Any

from flexx2_sim_ros.atomic import write_text
from flexx2_sim_ros.config_file import is_regular_file, read_config
from flexx2_sim_ros.effects.effect import Effect
from flexx2_sim_ros.effects.patch import ResidualPatch
from flexx2_sim_ros.effects.plugins import plug_ins
from flexx2_sim_ros.effects.randomisation import parse_randomisation, Randomisation
from flexx2_sim_ros.effects.ray import AlongRay
from flexx2_sim_ros.effects.tables import Curve, Form, PixelMap, plain, read_map, write_map
from flexx2_sim_ros.errors import InputError, shown, shown_path, unquoted
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.paths import config_dir
import yaml

_LONGEST_SEED = 12  # digits


@lru_cache(maxsize=1)
def registry() -> Mapping[str, type[Effect]]:
    """Return all effects by name, in the order of light: this package's and plug-ins'."""
    own = _own()
    known = {kind.name for kind in (*own, *_UNLISTED)}
    return MappingProxyType(_in_order([*own, *plug_ins(known)]))


def _own() -> list[type[Effect]]:
    package = import_module('flexx2_sim_ros.effects')
    for module in pkgutil.iter_modules(package.__path__):
        import_module(f'{package.__name__}.{module.name}')
    return [
        kind
        for kind in Effect.__subclasses__()
        if kind.__module__.startswith(f'{__package__}.') and kind.listed
    ]


def _in_order(kinds: Sequence[type[Effect]]) -> dict[str, type[Effect]]:
    found = sorted(kinds, key=lambda kind: (kind.stage, kind.order, kind.name))
    return {kind.name: kind for kind in found}


# A diagnosis writes the patch where no effect explains the gap, and compares with the other.
_UNLISTED: tuple[type[Effect], ...] = (ResidualPatch, AlongRay)


@lru_cache(maxsize=1)
def loadable() -> Mapping[str, type[Effect]]:
    """Return the effects that files can name: the registry's, and those of a diagnosis."""
    return MappingProxyType(_in_order([*registry().values(), *_UNLISTED]))


def of_role(role: str) -> type[Effect]:
    """Return the effect that is one of the diagnosis's own nuisances; see `Effect.role`."""
    return next(kind for kind in registry().values() if kind.role == role)


def ageing(names: Iterable[str]) -> list[str]:
    """Return which of these effects depend on the time since power-on: they have ``uptime``."""
    return [name for name in names if hasattr(loadable()[name], 'uptime')]


def aged(effects: Iterable[Effect], uptime: float | None) -> tuple[Effect, ...]:
    """Return effects; those that have ``uptime`` have this one, seconds, unless it is None."""
    since: Any = {} if uptime is None else {'uptime': uptime}
    return tuple(replace(one, **since) if hasattr(one, 'uptime') else one for one in effects)


def parse_effects(table: Any, where: str = 'effects') -> tuple[Effect, ...]:
    """
    Build effects from a table of their parameters.

    Parameters
    ----------
    table : mapping
        Parameters by effect name; None or an empty table for its typical values.
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
        raise InputError(f'{where}: must be a table of effects by name, got {shown(table)}')
    known = loadable()
    for name in table:
        if name not in known:
            raise InputError(
                f'{where}: {unquoted(name)}: must be one of {", ".join(registry())}, got an '
                'unknown effect'
            )
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
        ``schema: 1`` and ``effects:``, a table of parameters by effect name. Or the name of a
        preset, a file in ``config/effects`` without its ending: ``typical``. Or the name of an
        effect: that one, at its typical values. Or a file with ``randomisation:`` and the seed of
        a draw: ``randomisation.yaml#7``.

    Returns
    -------
    tuple of Effect
        In the order of light.

    Raises
    ------
    InputError
        When the file cannot be read or something in it cannot be used.

    """
    path = Path(path)
    preset = config_dir() / 'effects' / f'{path}.yaml'
    if str(path) == path.stem and not is_regular_file(path) and is_regular_file(preset):
        path = preset
    elif str(path) in registry() and not path.exists():
        return (registry()[str(path)](),)
    name, mark, seed = str(path).rpartition('#')
    there = os.path.lexists(path)  # Path.exists raises an error for a name that is too long.
    if mark and seed.isdecimal() and len(seed) < _LONGEST_SEED and not there:
        return load_randomisation(name).draw(1, int(seed))[0]
    if not there:
        raise InputError(
            f'{shown_path(path)}: must be a file, a preset such as typical, or the name of an '
            'effect (see flexx2 effects), got none of them'
        )
    content = read_config(path)
    if 'randomisation' in content:
        raise InputError(
            f'{shown_path(path)}: randomisation: must be drawn from: add # and a seed to the '
            f'path, for example {unquoted(path.name)}#7'
        )
    if 'effects' not in content:
        raise InputError(
            f'{shown_path(path)}: effects: must be a table of parameters by effect, got none'
        )
    table, where = content['effects'], f'{shown_path(path)}: effects'
    return parse_effects({} if table is None else _with_maps(table, path.parent, where), where)


def load_randomisation(path: str | Path) -> Randomisation:
    """
    Read distributions of effects, as `flexx2 gap randomise` writes them.

    Parameters
    ----------
    path : str or pathlib.Path
        A YAML file with ``schema: 1`` and ``randomisation:``.

    Raises
    ------
    InputError
        When the file cannot be read or something in it cannot be used.

    """
    where = f'{shown_path(path)}: randomisation'
    if not is_regular_file(Path(path)):
        raise InputError(f'{where}: must be in a file of flexx2 gap randomise, got no such file')
    content = read_config(Path(path))
    if 'randomisation' not in content:
        raise InputError(f'{where}: must be a table, got none')
    table = _with_maps_of_draws(content['randomisation'], Path(path).parent, where)
    return parse_randomisation(table, loadable(), where)


def randomisation_at(path: str | Path) -> Randomisation | None:
    """Return the distributions of a file, or None where it is no file or has effects instead."""
    path = Path(path)
    is_one = is_regular_file(path) and 'randomisation' in read_config(path)
    return load_randomisation(path) if is_one else None


def _with_maps_of_draws(table: Any, folder: Path, where: str) -> Any:
    # As `_with_maps`, one level deeper.
    effects = table.get('effects') if isinstance(table, Mapping) else None
    if not isinstance(effects, Mapping):
        return table
    out = {}
    for name, one in effects.items():
        own = {name: one['parameters']} if isinstance(one, Mapping) and 'parameters' in one else {}
        read = _with_maps(own, folder, where)
        out[name] = {**one, 'parameters': read[name]} if own else one
    return {**table, 'effects': out}


def save_randomisation(path: str | Path, one: Randomisation, comment: str = '') -> None:
    """
    Write distributions as a file that `load_randomisation` reads, with a comment above.

    A map is written beside it, as ``<name of the file>_<effect>.npz``.
    """
    before = maps_of_draws(path)
    _write_maps(Path(path).parent, one.effects, before)
    lines = [f'# {line}'.rstrip() for line in comment.splitlines()]
    content = one.plain()
    for name, drawn in content['effects'].items():
        drawn['parameters'] = for_reports({name: drawn['parameters']}, before)[name]
    table = {'schema': 1, 'randomisation': content}
    text = yaml.safe_dump(table, sort_keys=False, default_flow_style=None, width=99)
    write_text(path, '\n'.join([*lines, text]))


def _with_maps(table: Any, folder: Path, where: str) -> Any:
    # A table of a file with the maps that it names; anything else that is wrong stays.
    if not isinstance(table, Mapping):
        return table
    out = dict(table)
    for name, kind in loadable().items():
        values = out.get(name)
        for key, one in kind.tables().items():
            if one.kind == 'map' and isinstance(values, Mapping) and values.get(key) is not None:
                read = read_map(folder, values[key], f'{where}: {name}.{key}')
                out[name] = {**out[name], key: read}
    return out


def save_effects(path: str | Path, effects: Sequence[Effect], comment: str = '') -> None:
    """
    Write a set of effects as a file that `load_effects` reads; whole or not at all.

    A map is written beside it, as ``<effect>.npz``.

    Parameters
    ----------
    path : str or pathlib.Path
        The file, replaced if it exists.
    effects : sequence of Effect
        What to write.
    comment : str
        Put above it, a ``#`` before each line.

    """
    _write_maps(Path(path).parent, effects)
    write_text(path, effects_yaml(effects, comment))


def _write_maps(folder: Path, effects: Sequence[Effect], before: str = '') -> None:
    for effect in effects:
        for one in effect.forms.values():
            if isinstance(one, PixelMap):
                write_map(folder / map_file(effect.name, before), one)


def effects_yaml(effects: Sequence[Effect], comment: str = '') -> str:
    """Return what `save_effects` writes."""
    lines = [f'# {line}'.rstrip() for line in comment.splitlines()]
    lines += ['schema: 1', 'effects:' if effects else 'effects: {}']
    for effect in effects:
        lines.append(f'  {effect.name}:')
        for item in effect.parameters():
            # YAML takes 1e-05 for text; its own writer knows.
            number = yaml.safe_dump([getattr(effect, item.name)]).removeprefix('- ').strip()
            unit = f'{item.unit}, ' if item.unit else ''
            lines.append(f'    {item.name}: {number}  # {unit}{item.text}')
        lines += [_table_yaml(effect, name, one) for name, one in effect.forms.items()]
    return '\n'.join(lines) + '\n'


def map_file(effect: str, before: str = '') -> str:
    """Return the name of the file of an effect's map, with a text before it."""
    return f'{before}{effect}.npz'


def maps_of_draws(path: str | Path) -> str:
    """Return what the names of a file of distributions' maps begin with: a folder has several."""
    return f'{Path(path).stem}_'


def check_map_files(folder: str | Path, before: str = '') -> None:
    """
    Check that maps of effects can be written to a folder, before a long computation.

    `before` is as for `map_file`. Raises InputError where another file, such as a recording, has
    the name of a map's file.
    """
    for name, kind in loadable().items():
        path = Path(folder) / map_file(name, before)
        if any(one.kind == 'map' for one in kind.tables().values()) and path.exists():
            try:
                with open_npz(path) as archive:
                    keys = set(archive.headers)
            except InputError:
                keys = set()
            if keys != {'map'}:
                raise InputError(
                    f'{shown_path(path)}: must be free for the map of {name}, got another file'
                )


def for_reports(
    effects: Mapping[str, Mapping[str, Any]], before: str = ''
) -> dict[str, dict[str, Any]]:
    """Return settings by effect for a JSON file: a map as the name of its file, not its pixels."""
    return {
        name: plain(
            {
                key: map_file(name, before) if isinstance(value, PixelMap) else value
                for key, value in settings.items()
            }
        )
        for name, settings in effects.items()
    }


def _table_yaml(effect: Effect, name: str, one: Form) -> str:
    table = effect.tables()[name]
    unit = f', {table.unit}' if table.unit else ''
    if isinstance(one, PixelMap):
        return f'    {name}: {map_file(effect.name)}  # {table.text}{unit}'
    if not isinstance(one, Curve):
        number = yaml.safe_dump([one]).removeprefix('- ').strip()
        return f'    {name}: {number}  # {table.text}{unit}'
    text = yaml.safe_dump(one.plain(), default_flow_style=True, sort_keys=False, width=math.inf)
    return f'    # {table.text}{unit}; over {table.over}\n    {name}: {text.strip()}'

"""Read YAML files, those in ``config/`` and those that users give."""

from collections.abc import Callable
from dataclasses import dataclass
import os
from pathlib import Path
from stat import S_ISREG
from typing import Any

from flexx2_sim_ros.errors import InputError, shown, shown_path, unquoted
import yaml

# A camera profile or a set of effects has some kilobytes and 7 levels at most. Within these
# bounds a file takes a fraction of a second and some megabytes to read, whatever is in it.
_MOST_LEVELS = 30
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_KINDS: dict[type, str] = {dict: 'a table', list: 'a list'}


@dataclass(frozen=True)
class Limits:
    """What a file may have at most: bytes, values, and characters in one text."""

    size: int = 256 * 1024
    values: int = 10_000
    text: int = 10_000


_USUAL = Limits()


def is_regular_file(path: Path) -> bool:
    """Say whether there is an ordinary file; what cannot be a path is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # A name that is too long, or has a NUL or surrogate in it.
        return False


def read_config(path: Path, limits: Limits = _USUAL) -> dict[str, Any]:
    """
    Return a YAML file of schema 1.

    It is an ordinary file (no pipe, device or folder) of at most 256 KiB, 10,000 values, 30 levels
    and 10,000 characters in one text, without YAML aliases; other limits are for files that a
    program writes. Raises InputError when it cannot be read or is not a YAML mapping of schema 1.
    """
    content = read_mapping(path, limits)
    if content.get('schema') != 1:
        got = shown(content['schema']) if 'schema' in content else 'none'
        raise InputError(f'{shown_path(path)}: schema: must be 1 (a line "schema: 1"), got {got}')
    return content


def read_mapping(
    path: Path, limits: Limits = _USUAL, as_yaml: Callable[[str], str] = str
) -> dict[str, Any]:
    """
    Return a YAML file of any content; otherwise as `read_config`.

    ``as_yaml`` turns the text of a file of another kind into YAML. Raises InputError when the file
    cannot be read or is not a YAML mapping.
    """
    name = shown_path(path)
    try:
        text = as_yaml(read_bytes(path, limits.size).decode('utf-8'))
        _check_size(text, limits)
        content = yaml.load(text, Loader=_LOADER)  # noqa: S506
    except InputError as error:
        raise InputError(f'{name}: {error}') from error
    except FileNotFoundError as error:
        raise InputError(f'{name}: must be a YAML file, got no file') from error
    except Exception as error:  # PyYAML lets errors of all kinds out, e.g. of `!!bool x`.
        raise InputError(f'{name}: cannot be read as YAML: {_reason(error)}') from error
    if not isinstance(content, dict):
        raise InputError(f'{name}: must be a YAML mapping, got {shown(content)}')
    return content


def read_bytes(path: Path, most: int) -> bytes:
    """
    Return the content of an ordinary file of at most so many bytes.

    Raises InputError when it is a folder, a pipe or a device, or larger, OSError when it cannot be
    read.
    """
    # Looked at before it is opened: opening alone can set a device off, or wait for ever.
    if not S_ISREG(path.stat().st_mode):
        raise InputError('must be an ordinary file, got a folder, a pipe or a device')
    no_wait = getattr(os, 'O_NONBLOCK', 0)
    with open(path, 'rb', opener=lambda name, flags: os.open(name, flags | no_wait)) as file:
        content = file.read(most + 1) or b''
    if len(content) > most:
        raise InputError(f'must be at most {most} bytes long')
    return content


def _check_size(text: str, limits: Limits) -> None:
    # Looks at one parser event after the other, before anything is built from them.
    nodes = level = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise InputError(f'must have no YAML aliases, got *{unquoted(event.anchor)}')
        if isinstance(event, yaml.NodeEvent):
            nodes += 1
        if isinstance(event, yaml.CollectionStartEvent):
            level += 1
        if isinstance(event, yaml.CollectionEndEvent):
            level -= 1
        if nodes > limits.values:
            raise InputError(f'must have at most {limits.values} values')
        if level > _MOST_LEVELS:
            raise InputError(f'must have at most {_MOST_LEVELS} levels')
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > limits.text:
            raise InputError(f'must have at most {limits.text} characters in a text')


def _reason(error: Exception) -> str:
    # On one line, without the lines of the file that PyYAML and the path that OSError add.
    if isinstance(error, OSError):
        return error.strerror or type(error).__name__
    if isinstance(error, yaml.MarkedYAMLError):
        place = f' in line {error.problem_mark.line + 1}' if error.problem_mark else ''
        return f'{unquoted(error.problem or error.context)}{place}'
    return unquoted(str(error)) or type(error).__name__


def read_section(path: Path, section: str, kind: type) -> Any:
    """
    Return one top-level section of a YAML file of schema 1, a ``dict`` or ``list`` as `kind` says.

    Raises InputError as `read_config`, and when the section is missing, empty or of another kind.
    """
    found = read_config(path).get(section)
    if not (isinstance(found, kind) and found):
        raise InputError(
            f'{shown_path(path)}: {section}: must be {_KINDS[kind]} that is not empty, got '
            f'{shown(found)}'
        )
    return found

"""Read one section of a YAML file in ``config/``."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError
import yaml


def read_section(path: Path, section: str, kind: type) -> Any:
    """
    Return one top-level section of a YAML file.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    section : str
        The section's name.
    kind : type
        What it must be: ``dict`` or ``list``, and not empty.

    Returns
    -------
    dict or list
        As `kind` says.

    Raises
    ------
    InputError
        When the file cannot be read, is not YAML of schema 1, or the section is missing, empty or
        of another kind.

    """
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f'{path}: cannot be read as YAML: {error}') from error
    if not isinstance(content, dict) or content.get('schema') != 1:
        raise InputError(f'{path}: schema: wanted a mapping with schema 1')
    found = content.get(section)
    if not (isinstance(found, kind) and found):
        raise InputError(f'{path}: {section} is {found!r}, '
                         f'wanted a {kind.__name__} with something in it')
    return found

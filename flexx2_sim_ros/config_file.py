"""Read the YAML files in ``config/``."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError
import yaml


def read_config(path: Path) -> dict[str, Any]:
    """
    Return a YAML file of schema 1.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        When the file cannot be read or is not a YAML mapping of schema 1.

    """
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f'{path}: cannot be read as YAML: {error}') from error
    if not isinstance(content, dict) or content.get('schema') != 1:
        raise InputError(f'{path}: schema: wanted a mapping with schema 1')
    return content


def read_section(path: Path, section: str, kind: type) -> Any:
    """
    Return one top-level section of a YAML file of schema 1.

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
        As `read_config`, and when the section is missing, empty or of another kind.

    """
    found = read_config(path).get(section)
    if not (isinstance(found, kind) and found):
        raise InputError(f'{path}: {section} is {found!r}, '
                         f'wanted a {kind.__name__} with something in it')
    return found

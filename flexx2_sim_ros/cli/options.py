"""The options of a command: their types, and a table of them that reads like its help."""

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

from flexx2_sim_ros.processes import available_cores
from flexx2_sim_ros.profiles.files import PROFILE_HELP

SEEDS = -(2**63), 2**63 - 1
MOST_JOBS = 1024
MOST_FRAMES = 10_000_000  # Four days at 30 Hz.
_LONGEST = 20  # characters of a value that an error repeats


def whole_number(low: int, high: int | None = None) -> Callable[[str], int]:
    """Return an argument type: a whole number from `low`, up to `high` if there is one."""
    limit = f'of at least {low}' if high is None else f'from {low} to {high}'

    def holds(value: int) -> bool:
        return low <= value and (high is None or value <= high)

    return partial(_checked, int, holds, f'a whole number {limit}')


def number(low: float, high: float, *, above: bool = False) -> Callable[[str], float]:
    """Return an argument type: a number from `low` (or ``above`` it) to `high`."""
    limit = f'above {low:g}, up to {high:g}' if above else f'from {low:g} to {high:g}'

    def holds(value: float) -> bool:
        return low <= value <= high and not (above and value == low)

    return partial(_checked, float, holds, f'a number {limit}')


def _checked(kind: Any, holds: Callable[[Any], bool], what: str, text: str) -> Any:
    with suppress(ValueError):
        if holds(value := kind(text)):
            return value
    raise argparse.ArgumentTypeError(f'must be {what}, got {_short(text)}')


def _short(text: str) -> str:
    return repr(text if len(text) <= _LONGEST else f'{text[:_LONGEST]}...')


MOST_SEED = 10**9 - 1  # of the diagnosis
# Rows of other tables that have a name alone.
_SHARED = f"""
diagnosis DIAGNOSIS: folder that flexx2 gap diagnose has written
--profile NAME: {PROFILE_HELP}
--seed SEED: seed of the simulations (default 0)
--force: write over what is there
--jobs JOBS: number of processes (default: one per core)
--out DIR: folder for the results
--scheduler ADDRESS: use the Dask cluster of this scheduler, e.g. tcp://host:8786; its workers must
    see the recordings at the same paths
--known FILE: effects taken as given (a file as for flexx2 simulate --effects): the simulation has
    them, and only the rest of the gap is looked at, e.g. after a firmware update or with a filter
    switched on (default: none)
"""
_SHARED_MORE: dict[str, dict[str, Any]] = {
    '--profile': {'default': ''},
    '--seed': {'type': whole_number(0, MOST_SEED), 'default': 0},
    '--jobs': {'type': whole_number(1, MOST_JOBS), 'default': available_cores()},
    '--out': {'required': True},
}


class Step(NamedTuple):
    """A command of a command: what its parent's help says of it, its table, and what runs it."""

    text: str
    options: str
    run: Callable[[argparse.Namespace], int]
    values: Mapping[str, Any] = {}


class _Several(argparse.Action):
    # Keeps several values as a tuple, as functions of the package take them.

    def __call__(self, _parser: Any, namespace: Any, values: Any, _option: Any = None) -> None:
        setattr(namespace, self.dest, tuple(values))


def add_table(parser: argparse.ArgumentParser, table: str, **more: Any) -> None:
    """
    Add what a table lists to a parser.

    A row is ``NAME: help``, ``NAME METAVAR: help`` with one metavar for each value, or ``NAME
    one|another: help``. Rows that are indented go on with the help above. Without a metavar, a
    name with dashes is a switch. A name alone is an option that several commands have. At most one
    of rows that begin with ``/`` may be given, and exactly one of those that begin with ``!``.
    Empty lines part off a description above the rows and an example below them; both keep their
    lines if those of the example are indented. ``more`` has, by name (without dashes in front and
    with ``_`` for others), a dict of what else argparse gets; or the type, a function; or the
    default, anything else.
    """
    parts = table.strip('\n').split('\n\n')
    parser.description, parser.epilog = parts[0], parts[-1]
    if '\n  ' in parts[-1]:
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
    else:
        parser.description, parser.epilog = (
            one.replace('\n', ' ') for one in (parts[0], parts[-1])
        )
    shared = {head.partition(' ')[0]: (head, text) for head, text in _rows(_SHARED.strip('\n'))}
    sign = ''
    target: Any = parser
    for row, text in _rows(parts[1]) if len(parts) == 3 else ():
        before, sign, row = sign, row[: row[0] in '/!'], row.lstrip('/! ')
        if sign != before:
            target = parser.add_mutually_exclusive_group(required=sign == '!') if sign else parser
        head, text = (row, text) if text else shared[row]
        name, _, values = head.partition(' ')
        given: dict[str, Any] = {'help': text}
        if row == name and row in shared:
            given |= _SHARED_MORE.get(row, {})
        if '|' in values:
            given['choices'] = tuple(values.split('|'))
        elif ' ' in values:
            given['metavar'] = tuple(values.split(' '))
            given |= {'nargs': len(given['metavar']), 'action': _Several}
        elif values:
            given['metavar'] = values
        elif name.startswith('-'):
            given['action'] = 'store_true'
        own = more.pop(name.lstrip('-').replace('-', '_'), {})
        if not isinstance(own, dict):
            own = {'type' if callable(own) else 'default': own}
        target.add_argument(name, **{**given, **own})
    assert not more, f'no row has {", ".join(more)}'


def _rows(rows: str) -> Iterator[tuple[str, str]]:
    for row in rows.replace('\n    ', ' ').split('\n'):
        head, _, text = row.partition(': ')
        yield head, text

"""What several commands share: options, a progress bar, the command as it was typed."""

import argparse
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager
import json
import shlex
import sys
from typing import Any

from flexx2_sim_ros.cli.argument_types import MOST_JOBS, number, whole_number
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.processes import available_cores
from flexx2_sim_ros.profiles.files import find_profile, PROFILE_HELP
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

MOST_SEED = 10**9 - 1  # of the diagnosis


def add_profile(parser: argparse.ArgumentParser) -> None:
    """Add ``--profile``; `find_profile` reads it."""
    parser.add_argument('--profile', metavar='NAME', default='', help=PROFILE_HELP)


def add_seed(parser: argparse.ArgumentParser, most: int = MOST_SEED) -> None:
    """Add ``--seed`` of the simulations of a diagnosis."""
    parser.add_argument(
        '--seed', type=whole_number(0, most), default=0, help='seed of the simulations (default 0)'
    )


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add ``--force``; `atomic.check_no_overwrite` looks at it."""
    parser.add_argument('--force', action='store_true', help='write over what is there')


def add_jobs(parser: argparse.ArgumentParser) -> None:
    """Add ``--jobs``, by default one process per core."""
    parser.add_argument(
        '--jobs',
        type=whole_number(1, MOST_JOBS),
        default=available_cores(),
        help='number of processes (default: one per core)',
    )


def add_simulation(parser: argparse.ArgumentParser) -> None:
    """Add ``--profile``, ``--seed`` and ``--jobs`` of a command that simulates recordings."""
    add_profile(parser)
    add_seed(parser)
    add_jobs(parser)


def simulation(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what `add_simulation` and `add_scheduler` added, as functions of `gap` take it."""
    given = {name: getattr(arguments, name) for name in ('seed', 'jobs')}
    if 'scheduler' in arguments:
        given['scheduler'] = arguments.scheduler
    return {'profile': find_profile(arguments.profile), **given}


def add_diagnosis(parser: argparse.ArgumentParser) -> None:
    """Add the folder of a diagnosis."""
    parser.add_argument(
        'diagnosis', metavar='DIAGNOSIS', help='folder that flexx2 gap diagnose has written'
    )


def add_out(parser: argparse.ArgumentParser, default: str = '') -> None:
    """Add ``--out``, a folder; `default` says where results go without it."""
    text = 'folder for the results'
    parser.add_argument(
        '--out',
        required=not default,
        metavar='DIR',
        help=f'{text} (default: {default})' if default else text,
    )


def add_json(parser: argparse.ArgumentParser, name: str) -> None:
    """Add ``--json``; `print_json` prints the file of this name."""
    parser.add_argument(
        '--json', action='store_true', help=f'print {name} to standard output, and no table'
    )


def print_json(table: dict[str, Any]) -> None:
    """Print a table as JSON to standard output."""
    print(json.dumps(table, indent=2, allow_nan=False))


def messages(*, soft_wrap: bool = False) -> Console:
    """Return the console for what is said besides results, as it is."""
    return Console(stderr=True, markup=False, highlight=False, soft_wrap=soft_wrap)


def plain_table(*names: str, text: Container[str] = (), whole: Container[str] = ()) -> Table:
    """Return a table without edges; columns of `text` are at the left, `whole` do not wrap."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    for name in names:
        table.add_column(name, justify='left' if name in text else 'right', no_wrap=name in whole)
    return table


def print_lines(console: Console, lines: Iterable[str]) -> None:
    """Print lines whose text may come from files."""
    for line in lines:
        console.print(printable(line))


def add_scheduler(parser: argparse.ArgumentParser) -> None:
    """Add ``--scheduler``, the address of a Dask cluster."""
    parser.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='use the Dask cluster of this scheduler, e.g. tcp://host:8786; its workers must see '
        'the recordings at the same paths',
    )


def add_pose_prior(
    parser: argparse.ArgumentParser, default: tuple[float, float] | None, text: str
) -> None:
    """Add ``--pose-prior``; `text` says what its default is."""
    parser.add_argument(
        '--pose-prior',
        type=number(0, 1e3, above=True),
        nargs=2,
        default=default,
        metavar=('METRES', 'DEGREES'),
        help='how inaccurate the given camera poses are: standard deviations of position and '
        f'angle (default: {text})',
    )


def add_known(parser: argparse.ArgumentParser, text: str = 'none') -> None:
    """Add ``--known``; `text` says what its default is."""
    parser.add_argument(
        '--known',
        metavar='FILE',
        help='effects taken as given (a file as for flexx2 simulate --effects): the simulation '
        'has them, and only the rest of the gap is looked at, e.g. after a firmware update or '
        f'with a filter switched on (default: {text})',
    )


def read_known(path: str | None) -> dict[str, dict[str, Any]] | None:
    """Return the parameters by effect of a file of effects; None for no file."""
    # Imported here: the diagnosis takes seconds to load.
    from flexx2_sim_ros.effects import load_effects
    from flexx2_sim_ros.gap.inference.effects import table_of

    return None if path is None else table_of(load_effects(path))


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[str, float], None]]:
    """
    Show a progress bar on a terminal while the block runs.

    Yields
    ------
    callable
        To be called with what is being done, and the fraction that is done.

    """
    with Progress(
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as progress:
        # The bar pulses until a part is done: how long the first one takes is not known.
        task = progress.add_task('starting', total=None)
        yield lambda text, done: progress.update(
            task, description=printable(text), total=1.0 if done else None, completed=done
        )


def command_line(*words: str) -> str:
    """Return the command as it was typed, or `words` where Python code calls it."""
    typed = sys.argv[1:] if sys.argv[1:2] == list(words[:1]) else words
    return shlex.join(['flexx2', *typed])

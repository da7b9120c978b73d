"""What several commands share: options, a progress bar, the command as it was typed."""

import argparse
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager
import inspect
import shlex
import sys
from typing import Any

from flexx2_sim_ros.atomic import as_json
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.profiles.files import find_profile
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column, Table


def call(function: Callable[..., Any], arguments: argparse.Namespace, **more: Any) -> Any:
    """
    Call a function, or make a value, with those options of a command that are its parameters.

    An option that was left out and has no default is left out here, too. `--profile` becomes a
    profile. `more` goes before the options.
    """
    names = inspect.signature(function).parameters.keys() & vars(arguments).keys()
    given = {name: getattr(arguments, name) for name in names - more.keys()}
    given = {name: value for name, value in given.items() if value is not None}
    if 'profile' in given:
        given['profile'] = find_profile(given['profile'])
    return function(**given, **more)


def call_and_print(
    function: Callable[..., Any],
    arguments: argparse.Namespace,
    written: str,
    show: Callable[[dict[str, Any], Console], None],
    **more: Any,
) -> dict[str, Any]:
    """
    Call a function as `call` does, with a progress bar; print and return the table that it makes.

    `show` prints it, and below it stands what was `written`. With `--json` it is JSON instead.
    """
    console = messages()
    with progress_bar(console) as progress:
        table: dict[str, Any] = call(function, arguments, progress=progress, **more)
    if arguments.json:
        print(as_json(table), end='')
    else:
        show(table, console)
        console.print(f'{written} ({table["seconds"]:.0f} s)')
    return table


def messages(*, soft_wrap: bool = False) -> Console:
    """Return the console for what is said besides results, as it is."""
    return Console(stderr=True, markup=False, highlight=False, soft_wrap=soft_wrap)


def ruled_table(
    heads: Iterable[str | Column], rows: Iterable[Iterable[str]] = (), **style: Any
) -> Table:
    """Return a table with a line below its heads; texts of rows may come from files."""
    table = Table(*heads, box=SIMPLE_HEAD, **style)
    for row in rows:
        table.add_row(*map(printable, row))
    return table


def plain_table(*names: str, text: Container[str] = (), whole: Container[str] = ()) -> Table:
    """Return a table without edges; columns of `text` are at the left, `whole` do not wrap."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    for name in names:
        table.add_column(name, justify='left' if name in text else 'right', no_wrap=name in whole)
    return table


def print_lines(console: Console, lines: Iterable[str], style: str | None = None) -> None:
    """Print lines whose text may come from files."""
    for line in lines:
        console.print(printable(line), style=style)


def read_known(path: str | None) -> dict[str, dict[str, Any]] | None:
    """Return the parameters by effect of a file of effects; None for no file."""
    # Imported here: the diagnosis takes seconds to load.
    from flexx2_sim_ros.effects import load_effects
    from flexx2_sim_ros.gap.inference.effects import table_of

    return None if path is None else table_of(load_effects(path))


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on a terminal; yield a function of what is being done, and how much."""
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

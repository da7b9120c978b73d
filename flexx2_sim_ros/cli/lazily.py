"""Add commands to a parser, importing the module of a command only where it is needed."""

from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any

ALL = ('*',)  # words that name every command


def words_of(argv: Sequence[str] | None) -> tuple[str, ...]:
    """Return the arguments that are no options; `ALL` for None."""
    return ALL if argv is None else tuple(one for one in argv if not one.startswith('-'))


def add_commands(
    commands: Any, texts: Mapping[str, str], modules: Mapping[str, str], words: Sequence[str]
) -> None:
    """
    Add commands to the subparsers of a parser.

    Parameters
    ----------
    commands : argparse subparsers
        Where they are added.
    texts : mapping of str to str
        Of each command, what the help of the parser says.
    modules : mapping of str to str
        Its module, whose ``add_parser`` adds its options.
    words : sequence of str
        The command and its own words, or `ALL`. Other commands get no options.

    """
    for name, text in texts.items():
        if words == ALL or [*words[:1]] == [name]:
            described = SimpleNamespace(add_parser=partial(commands.add_parser, help=text))
            described.words = words if words == ALL else words[1:]
            import_module(modules[name]).add_parser(described)
        else:
            commands.add_parser(name, help=text)

"""Add commands to a parser, importing the module of a command only where it is needed."""

from collections.abc import Mapping, Sequence
from importlib import import_module
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

    A module has ``add_options``, which gets the parser, and ``run``, which gets the arguments; or
    commands of its own: ``add_options``, which gets the words as well.

    Parameters
    ----------
    commands : argparse subparsers
        Where they are added.
    texts : mapping of str to str
        Of each command, what the help of the parser says.
    modules : mapping of str to str
        The module of each.
    words : sequence of str
        The command and its own words, or `ALL`. Other commands get no options.

    """
    for name, text in texts.items():
        parser = commands.add_parser(name, help=text)
        if words == ALL or [*words[:1]] == [name]:
            module = import_module(modules[name])
            if hasattr(module, 'run'):
                parser.set_defaults(run=module.run)
                module.add_options(parser)
            else:
                module.add_options(parser, words if words == ALL else words[1:])

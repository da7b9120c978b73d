"""The subcommands of `flexx2`."""

import argparse
import re
from typing import NoReturn

from flexx2_sim_ros import __version__
from flexx2_sim_ros.cli import (
    batch,
    characterize,
    compiling,
    convert,
    demo,
    effects,
    export,
    gap,
    modes,
    record,
    replay,
    simulate,
    view,
)
from flexx2_sim_ros.errors import InputError, unquoted

# What argparse says of a word that is none of several; Python 3.12 and later leave out quotes.
_CHOICE = re.compile(r'(.*): invalid choice: (.*) \(choose from (.*)\)', re.DOTALL)
_QUOTE = "'"


class _Parser(argparse.ArgumentParser):
    # Prints errors in one sentence, like the commands.

    def error(self, message: str) -> NoReturn:
        said = message.removeprefix('argument ')
        if choice := _CHOICE.fullmatch(said):
            name, value, known = choice.groups()
            said = f'{name}: must be one of {known.replace(_QUOTE, "")}, got {unquoted(value)}'
        raise InputError(f'{said} (see {self.prog} --help)')


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, with all subcommands."""
    parser = _Parser(
        prog='flexx2',
        description='A simulated PMD Flexx2 time-of-flight camera, and tools that measure a depth '
        "camera's noise and find out why it differs from its simulation. flexx2 COMMAND --help "
        'explains a command.',
        epilog='For RViz and Foxglove there are layouts in config/ (in an install: '
        'share/flexx2_sim_ros/config): flexx2.rviz and foxglove.json.',
    )
    parser.add_argument('--version', action='version', version=__version__)
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for module in (
        modes,
        simulate,
        characterize,
        effects,
        export,
        demo,
        view,
        record,
        replay,
        convert,
        gap,
        batch,
        compiling,
    ):
        module.add_parser(commands)
    return parser


def run(argv: list[str] | None) -> int:
    """Run the subcommand in the arguments; see `flexx2_sim_ros.cli.main`."""
    arguments = make_parser().parse_args(argv)
    return int(arguments.run(arguments))

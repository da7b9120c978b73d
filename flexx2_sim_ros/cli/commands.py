"""The subcommands of `flexx2`."""

import argparse
from collections.abc import Sequence
import re
import sys
from typing import Any, NoReturn

from flexx2_sim_ros import __version__
from flexx2_sim_ros.cli.lazily import add_commands, words_of
from flexx2_sim_ros.errors import InputError, unquoted

# What `flexx2 --help` says of each command; its module is imported when it is the one that is run.
COMMANDS = {
    'modes': "list the camera's modes",
    'simulate': 'simulate the camera on a scene from a file',
    'characterize': 'measure the noise of a depth camera with a flat board',
    'effects': 'list the effects beyond the noise model, or draw one of them',
    'export': "write a camera's noise for a mapper or another simulator",
    'demo': 'run a Go1 with two cameras and show what they see',
    'view': 'show live cameras, recordings or a diagnosis in a browser; drive the robot',
    'record': 'record all cameras into a bag',
    'replay': 'publish the messages of a bag',
    'convert': 'convert bags, images and .npz of any depth camera to a recording',
    'gap': 'find out why recordings differ from the simulation',
    'batch': 'simulate the cameras of many robots at once, and draw their height grids',
    'compile': 'compile the camera before its first start',
}
MODULES = {'compile': 'compiling'}  # of commands whose module has another name
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

    def _print_message(self, message: str, file: Any = None) -> None:
        # argparse's own hides that nothing could be written, e.g. to a closed pipe.
        print(message, end='', file=file or sys.stderr)


def make_parser(argv: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """
    Return the parser of the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments: only the command that they name has its options. Default: all commands have.

    """
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
    modules = {name: f'flexx2_sim_ros.cli.{MODULES.get(name, name)}' for name in COMMANDS}
    add_commands(commands, COMMANDS, modules, words_of(argv))
    return parser


def run(argv: Sequence[str] | None) -> int:
    """Run the subcommand in the arguments; see `flexx2_sim_ros.cli.main`."""
    argv = sys.argv[1:] if argv is None else argv
    arguments = make_parser(argv).parse_args(argv)
    return int(arguments.run(arguments))

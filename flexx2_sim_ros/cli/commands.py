"""The subcommands of `flexx2` and of `flexx2 gap`; the module of one is imported to run it."""

import argparse
from collections.abc import Mapping, Sequence
from importlib import import_module
import re
import sys
from typing import Any, NoReturn

from flexx2_sim_ros import __version__
from flexx2_sim_ros.errors import InputError, unquoted
from flexx2_sim_ros.paths import checkout

# What `flexx2 --help` says of each command, and `flexx2 gap --help` of those of `gap`.
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
GAP_COMMANDS = {
    'start': 'go from recordings to a diagnosis, with questions',
    'diagnose': 'find which effects cause the gap, where it lies and how much they explain',
    'plan': 'write a checklist of what to record, and what it will be able to find',
    'target': 'draw a target to print, for ground truth from gray images',
    'check': 'check whether a diagnosis holds on recordings that it has never seen',
    'cost': 'measure what the gap costs in what reads depth on a robot',
    'next': 'say which recording would settle what a diagnosis leaves open',
    'randomise': 'write distributions of the diagnosed effects, for training on many cameras',
    'truth': 'make ground truth for recordings of a real camera',
    'walk': 'measure how often a walking robot fails with the diagnosed camera',
    'benchmark': 'measure how often the diagnosis is right',
}
_GAP = (
    'Compare recordings of a real camera with the simulation of the same scenes. The gap is the '
    'difference between the two.',
    'example: flexx2 gap diagnose recordings --out diagnosis',
)
# Of commands whose module has another name. The blind camera is not installed.
MODULES = {'compile': 'flexx2_sim_ros.cli.compiling', 'gap_benchmark': 'study.benchmark.command'}
ALL = ('*',)  # words that name every command
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
    """Return the parser; given ``argv``, only the command that it names has its options."""
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
    # Only the words that are no options name a command.
    words = ALL if argv is None else tuple(one for one in argv if not one.startswith('-'))
    _add_commands(commands, COMMANDS, '', words)
    return parser


def _add_commands(
    commands: Any, texts: Mapping[str, str], room: str, words: tuple[str, ...]
) -> None:
    # The module of a command that the words name has `OPTIONS` and perhaps `VALUES` for
    # `add_table`, `run`, and perhaps `STEPS`, which are commands of its own.
    for name, text in texts.items():
        parser = commands.add_parser(name, help=text)
        if words != ALL and words[:1] != (name,):
            continue
        if name == 'gap':
            parser.description, parser.epilog = _GAP
            own = parser.add_subparsers(dest='gap_command', required=True, metavar='COMMAND')
            _add_commands(own, _gap_commands(), 'gap_', words if words == ALL else words[1:])
            continue
        # Imported here: it loads profiles, which the help of all commands should not wait for.
        from flexx2_sim_ros.cli.options import add_table

        name = f'{room}{name}'
        module = import_module(MODULES.get(name, f'flexx2_sim_ros.cli.{name}'))
        add_table(parser, module.OPTIONS, **getattr(module, 'VALUES', {}))
        if hasattr(module, 'run'):
            parser.set_defaults(run=module.run)
        if hasattr(module, 'STEPS'):
            alone = hasattr(module, 'run')  # The command does something without a step, too.
            steps = parser.add_subparsers(
                required=not alone, metavar='|'.join(module.STEPS) if alone else 'STEP'
            )
            for one, step in module.STEPS.items():
                of_step = steps.add_parser(one, help=step.text)
                add_table(of_step, step.options, **step.values)
                of_step.set_defaults(run=step.run)


def _gap_commands() -> dict[str, str]:
    texts = dict(GAP_COMMANDS)
    if (folder := checkout()) is None:
        del texts['benchmark']
    elif str(folder) not in sys.path:
        sys.path.append(str(folder))
    return texts


def run(argv: Sequence[str] | None) -> int:
    """Run the subcommand in the arguments; see `flexx2_sim_ros.cli.main`."""
    argv = sys.argv[1:] if argv is None else argv
    arguments = make_parser(argv).parse_args(argv)
    return int(arguments.run(arguments))

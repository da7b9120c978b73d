"""The command `flexx2`."""

import argparse
import sys

from flexx2_sim_ros import __version__
from flexx2_sim_ros.cli import (
    batch,
    characterize,
    compiling,
    convert,
    demo,
    effects,
    gap,
    modes,
    record,
    replay,
    simulate,
    view,
)
from flexx2_sim_ros.errors import InputError


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        Arguments, the process's when left out.

    Returns
    -------
    int
        Exit code: 0 for success, 2 for something given that cannot be used, 130 for Ctrl-C.

    """
    parser = argparse.ArgumentParser(
        prog='flexx2', description='A simulated PMD Flexx2 time-of-flight camera.',
        epilog='For RViz and Foxglove there are layouts in config/ (in an install: '
        'share/flexx2_sim_ros/config): flexx2.rviz and foxglove.json.')
    parser.add_argument('--version', action='version', version=__version__)
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for module in (modes, simulate, characterize, effects, demo, view, record, replay, convert,
                   gap, batch, compiling):
        module.add_parser(commands)
    arguments = parser.parse_args(argv)
    try:
        return int(arguments.run(arguments))
    except InputError as error:
        print(f'flexx2: error: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == '__main__':
    sys.exit(main())

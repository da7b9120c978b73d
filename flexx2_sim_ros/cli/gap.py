"""`flexx2 gap`: diagnose the sim-to-real gap."""

import argparse
from collections.abc import Sequence
import sys

from flexx2_sim_ros.cli.lazily import add_commands
from flexx2_sim_ros.paths import checkout

COMMANDS = {
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


def add_options(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Add the commands that the words name."""
    parser.description = (
        'Compare recordings of a real camera with the simulation of the same scenes. '
        'The gap is the difference between the two.'
    )
    parser.epilog = 'example: flexx2 gap diagnose recordings --out diagnosis'
    subcommands = parser.add_subparsers(dest='gap_command', required=True, metavar='COMMAND')
    texts, modules = dict(COMMANDS), {name: f'flexx2_sim_ros.cli.gap_{name}' for name in COMMANDS}
    if (folder := checkout()) is None:
        del texts['benchmark']  # The blind camera is not installed.
    else:
        modules['benchmark'] = 'study.benchmark.command'
        if str(folder) not in sys.path:
            sys.path.append(str(folder))
    add_commands(subcommands, texts, modules, words)

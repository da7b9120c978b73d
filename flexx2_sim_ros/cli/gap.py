"""`flexx2 gap`: diagnose the sim-to-real gap."""

from importlib.util import find_spec
from typing import Any

from flexx2_sim_ros.cli.lazily import add_commands

COMMANDS = {
    'diagnose': 'find which effects cause the gap, where it lies and how much they explain',
    'plan': 'write a checklist of what to record, and what it will be able to find',
    'target': 'draw a target to print, for ground truth from gray images',
    'calibrate': 'fit curves, maps and parameters of the diagnosed effects to recordings',
    'check': 'check whether a diagnosis holds on recordings that it has never seen',
    'cost': 'measure what the gap costs in what reads depth on a robot',
    'next': 'say which recording would settle what a diagnosis leaves open',
    'randomise': 'write distributions of the diagnosed effects, for training on many cameras',
    'truth': 'make ground truth for recordings of a real camera',
    'walk': 'measure how often a walking robot fails with the diagnosed camera',
    'benchmark': 'measure how often the diagnosis is right',
}


def add_parser(commands: Any) -> None:
    """Add the subcommands."""
    parser = commands.add_parser(
        'gap',
        description='Compare recordings of a real camera with the simulation of the same scenes. '
        'The gap is the difference between the two.',
        epilog='example: flexx2 gap diagnose recordings --out diagnosis',
    )
    subcommands = parser.add_subparsers(dest='gap_command', required=True, metavar='COMMAND')
    texts = dict(COMMANDS)
    if not find_spec('flexx2_sim_ros.cli.gap_benchmark'):
        del texts['benchmark']
    add_commands(subcommands, texts, {name: f'gap_{name}' for name in texts}, commands.words)

"""`flexx2 gap`: diagnose the sim-to-real gap."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from flexx2_sim_ros.cli import (
    gap_calibrate,
    gap_check,
    gap_cost,
    gap_diagnose,
    gap_next,
    gap_plan,
    gap_randomise,
    gap_target,
    gap_truth,
    gap_walk,
)


def add_parser(commands: Any) -> None:
    """Add the subcommands."""
    parser = commands.add_parser(
        'gap',
        help='find out why recordings differ from the simulation',
        description='Compare recordings of a real camera with the simulation of the same scenes. '
        'The gap is the difference between the two.',
        epilog='example: flexx2 gap diagnose recordings --out diagnosis',
    )
    subcommands = parser.add_subparsers(dest='gap_command', required=True, metavar='COMMAND')
    gap_diagnose.add_parser(subcommands)
    gap_plan.add_parser(subcommands)
    gap_target.add_parser(subcommands)
    gap_calibrate.add_parser(subcommands)
    gap_check.add_parser(subcommands)
    gap_cost.add_parser(subcommands)
    gap_next.add_parser(subcommands)
    gap_randomise.add_parser(subcommands)
    gap_truth.add_parser(subcommands)
    gap_walk.add_parser(subcommands)
    if find_spec('flexx2_sim_ros.cli.gap_benchmark'):
        import_module('flexx2_sim_ros.cli.gap_benchmark').add_parser(subcommands)

"""`flexx2 gap randomise`: distributions of effects for training."""

import argparse

from flexx2_sim_ros.atomic import check_no_overwrite, checked_target
from flexx2_sim_ros.cli.common import messages, print_lines
from rich.box import SIMPLE_HEAD
from rich.table import Table

OPTIONS = """
Write what a diagnosis knows of its camera as distributions: named effects with the uncertainty and
the correlations of their parameters, effects that could not be decided as in the catalogue, all
others off. flexx2 simulate --draw, the node and BatchCamera draw cameras from them.

diagnosis
--out FILE: YAML file to write
--force

example: flexx2 gap randomise diagnosis/ --out randomisation.yaml
"""
VALUES = {'out': {'required': True}}


def run(arguments: argparse.Namespace) -> int:
    """Write the file and print its distributions."""
    from flexx2_sim_ros.gap.randomise import comment, randomise

    check_no_overwrite('--out', [checked_target(arguments.out)], arguments.force)
    found = randomise(arguments.diagnosis, arguments.out)
    console = messages()
    shown = Table('parameter', 'mean', 'spread', 'narrower by', box=SIMPLE_HEAD)
    for one in found.randomisation.distributions:
        factor = found.narrower.get(one.name)
        shown.add_row(
            one.name,
            'uniform' if one.mean is None else f'{one.mean:.3g}',
            f'{one.spread:.2g}',
            '' if factor is None else f'{factor:.1f}',
        )
    console.print(shown)
    print_lines(console, comment(found)[1:])
    console.print(str(arguments.out))
    return 0

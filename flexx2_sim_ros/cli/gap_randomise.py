"""`flexx2 gap randomise`: distributions of effects for training."""

import argparse

from flexx2_sim_ros.atomic import check_no_overwrite, checked_target
from flexx2_sim_ros.cli.common import messages, print_lines, ruled_table

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
    rows = [
        [
            one.name,
            'uniform' if one.mean is None else f'{one.mean:.3g}',
            f'{one.spread:.2g}',
            f'{found.narrower[one.name]:.1f}' if one.name in found.narrower else '',
        ]
        for one in found.randomisation.distributions
    ]
    console.print(ruled_table(('parameter', 'mean', 'spread', 'narrower by'), rows))
    print_lines(console, comment(found)[1:])
    console.print(str(arguments.out))
    return 0

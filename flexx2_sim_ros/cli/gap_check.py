"""`flexx2 gap check`: check a diagnosis on recordings that it has never seen."""

import argparse
from typing import Any

from flexx2_sim_ros.cli.common import (
    add_diagnosis,
    add_json,
    add_known,
    add_out,
    add_pose_prior,
    add_scheduler,
    add_simulation,
    print_json,
    print_lines,
    progress_bar,
    read_known,
)
from flexx2_sim_ros.errors import printable
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Column, Table


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'check',
        description='Compare the recordings in FRESH with their simulation, before and after the '
        'effects of DIAGNOSIS/effects.yaml are simulated. Prints a table with 90 % intervals over '
        'recordings, and writes check.json and check.html. The exit status is 0 if the gap '
        'shrinks and no physical measure gets significantly worse, 1 if not, and 2 if something '
        'cannot be used. Recordings that were part of the diagnosis are refused.',
        epilog='example: flexx2 gap check diagnosis/ fresh/ --out checked/',
    )
    add_diagnosis(parser)
    parser.add_argument(
        'fresh', metavar='FRESH', help='folder of recordings with clean_depth (.npz or bags)'
    )
    add_out(parser, 'DIAGNOSIS')
    add_json(parser, 'check.json')
    add_known(parser, 'as in the diagnosis')
    add_simulation(parser)
    add_scheduler(parser)
    add_pose_prior(parser, None, 'as in the diagnosis')
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Check with a progress bar; print the table or JSON."""
    from flexx2_sim_ros.gap import check
    from flexx2_sim_ros.profiles.files import find_profile

    console = Console(stderr=True, markup=False)
    out = arguments.out or arguments.diagnosis
    prior = arguments.pose_prior
    with progress_bar(console) as progress:
        table = check(
            arguments.diagnosis,
            arguments.fresh,
            profile=find_profile(arguments.profile),
            seed=arguments.seed,
            jobs=arguments.jobs,
            out=out,
            pose_prior=(prior[0], prior[1]) if prior else None,
            scheduler=arguments.scheduler,
            known=read_known(arguments.known),
            progress=progress,
        )
    if arguments.json:
        print_json(table)
    else:
        _print(table, console)
        console.print(f'{out}: check.json, check.html ({table["seconds"]:.0f} s)', highlight=False)
    return 0 if table['holds'] else 1


def _print(table: dict[str, Any], console: Console) -> None:
    from flexx2_sim_ros.gap.report.check_page import headline, lines, sentences

    console.print(printable(headline(table)), style='bold', highlight=False)
    shown = Table(
        Column(overflow='fold'),
        'before',
        'after',
        'two simulations',
        'change',
        '',
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for line in lines(table):
        # A value above its interval, so that the table fits a terminal of 80 columns.
        shown.add_row(*(text.replace(' (', '\n(') for text in line))
    console.print(shown)
    print_lines(console, sentences(table))

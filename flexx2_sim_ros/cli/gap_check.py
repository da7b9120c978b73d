"""`flexx2 gap check`: check a diagnosis on recordings that it has never seen."""

import argparse
import json
import os
from typing import Any

from flexx2_sim_ros.cli.argument_types import MOST_JOBS, number, whole_number
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.profiles.files import PROFILE_HELP
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

KNOWN_HELP = (
    'effects taken as given (a file as for flexx2 simulate --effects): the simulation has them, '
    'and only the rest of the gap is looked at, e.g. after a firmware update or with a filter '
    'switched on'
)


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'check',
        help='check whether a diagnosis holds on recordings that it has never seen',
        description='Compare the recordings in FRESH with their simulation, before and after the '
        'effects of DIAGNOSIS/effects.yaml are simulated. Prints a table with 90 % intervals over '
        'recordings, and writes check.json and check.html. The exit status is 0 if the gap '
        'shrinks and no physical measure gets significantly worse, 1 if not, and 2 if something '
        'cannot be used. Recordings that were part of the diagnosis are refused.',
        epilog='example: flexx2 gap check diagnosis/ fresh/ --out checked/',
    )
    parser.add_argument(
        'diagnosis', metavar='DIAGNOSIS', help='folder that flexx2 gap diagnose has written'
    )
    parser.add_argument(
        'fresh', metavar='FRESH', help='folder of recordings with clean_depth (.npz or bags)'
    )
    parser.add_argument('--out', metavar='DIR', help='folder for the results (default: DIAGNOSIS)')
    parser.add_argument(
        '--json', action='store_true', help='print check.json to standard output, and no table'
    )
    parser.add_argument(
        '--known', metavar='FILE', help=f'{KNOWN_HELP} (default: as in the diagnosis)'
    )
    parser.add_argument('--profile', metavar='NAME', default='', help=PROFILE_HELP)
    parser.add_argument(
        '--seed',
        type=whole_number(0, 10**9 - 1),
        default=0,
        help='seed of the simulations (default 0)',
    )
    parser.add_argument(
        '--jobs',
        type=whole_number(1, MOST_JOBS),
        default=os.cpu_count() or 1,
        help='number of processes (default: one per core)',
    )
    parser.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='use the Dask cluster of this scheduler; its workers must see the same paths',
    )
    parser.add_argument(
        '--pose-prior',
        type=number(0, 1e3, above=True),
        nargs=2,
        metavar=('METRES', 'DEGREES'),
        help='how inaccurate the given camera poses are (default: as in the diagnosis)',
    )
    parser.set_defaults(run=run)


def read_known(path: str | None) -> dict[str, dict[str, float]] | None:
    """Return the parameters by effect of a file of effects; None for no file."""
    from flexx2_sim_ros.effects import load_effects

    if path is None:
        return None
    return {
        effect.name: {p.name: float(getattr(effect, p.name)) for p in effect.parameters()}
        for effect in load_effects(path)
    }


def run(arguments: argparse.Namespace) -> int:
    """Check with a progress bar; print the table or JSON."""
    from flexx2_sim_ros.gap import check
    from flexx2_sim_ros.profiles.files import find_profile

    console = Console(stderr=True, markup=False)
    out = arguments.out or arguments.diagnosis
    prior = arguments.pose_prior
    with Progress(
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        task = progress.add_task('starting', total=1.0)
        table = check(
            arguments.diagnosis,
            arguments.fresh,
            profile=find_profile(arguments.profile) if arguments.profile else None,
            seed=arguments.seed,
            jobs=arguments.jobs,
            out=out,
            pose_prior=(prior[0], prior[1]) if prior else None,
            scheduler=arguments.scheduler,
            known=read_known(arguments.known),
            progress=lambda text, share: progress.update(task, description=text, completed=share),
        )
    if arguments.json:
        print(json.dumps(table, indent=2, allow_nan=False))
    else:
        _print(table, console)
        console.print(f'{out}: check.json, check.html ({table["seconds"]:.0f} s)', highlight=False)
    return 0 if table['holds'] else 1


def _print(table: dict[str, Any], console: Console) -> None:
    from flexx2_sim_ros.gap.report.check_page import headline, lines, sentences

    console.print(printable(headline(table)), style='bold', highlight=False)
    shown = Table('', 'before', 'after', 'two simulations', 'change', '')
    for line in lines(table):
        # A value above its interval, so that the table fits a terminal of 80 columns.
        shown.add_row(*(text.replace(' (', '\n(') for text in line))
    console.print(shown)
    for text in sentences(table):
        console.print(printable(text), highlight=False)

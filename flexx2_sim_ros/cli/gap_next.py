"""`flexx2 gap next`: say which recording would settle what a diagnosis leaves open."""

import argparse
import json
import os
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import check_folder, output_folder, write_text
from flexx2_sim_ros.cli.argument_types import MOST_JOBS, whole_number
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.profiles.files import PROFILE_HELP
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

_FILE = 'next.json'


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'next',
        help='say which recording would settle what a diagnosis leaves open',
        description='Simulate the explanations that DIAGNOSIS leaves open in scenes that are easy '
        'to set up, and rank the scenes by how well a recording would tell the explanations '
        'apart. Prints the ranking and writes next.json.',
        epilog='example: flexx2 gap next diagnosis/',
    )
    parser.add_argument(
        'diagnosis', metavar='DIAGNOSIS', help='folder that flexx2 gap diagnose has written'
    )
    parser.add_argument('--out', metavar='DIR', help='folder for next.json (default: DIAGNOSIS)')
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
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Rank scenes with a progress bar, and print the ranking."""
    from flexx2_sim_ros.gap.planning.next_recording import suggest
    from flexx2_sim_ros.profiles.files import find_profile

    console = Console(stderr=True, markup=False)
    out = Path(arguments.out or arguments.diagnosis)
    check_folder(out)
    with Progress(
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        task = progress.add_task('starting', total=1.0)
        table = suggest(
            arguments.diagnosis,
            profile=find_profile(arguments.profile) if arguments.profile else None,
            seed=arguments.seed,
            jobs=arguments.jobs,
            progress=lambda text, share: progress.update(task, description=text, completed=share),
        )
    write_text(output_folder(out) / _FILE, json.dumps(table, indent=2, allow_nan=False) + '\n')
    shown = Table('bits', 'record', 'tells apart best')
    for row in table['ranking']:
        pair = ' against '.join(row['best_told_apart'])
        shown.add_row(f'{row["bits"]:.2f}', printable(row['words']), printable(pair))
    console.print(shown)
    console.print(
        f'{table["most_bits"]:.2f} bits would decide between all {len(table["explanations"])} '
        f'explanations. {out}: {_FILE}',
        highlight=False,
    )
    return 0

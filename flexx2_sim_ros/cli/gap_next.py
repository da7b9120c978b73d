"""`flexx2 gap next`: say which recording would settle what a diagnosis leaves open."""

import argparse
import json
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import check_outputs, output_folder, write_text
from flexx2_sim_ros.cli.common import add_jobs, add_profile, add_seed, progress_bar
from flexx2_sim_ros.errors import printable
from rich.console import Console
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
    add_profile(parser)
    add_seed(parser)
    add_jobs(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Rank scenes with a progress bar, and print the ranking."""
    from flexx2_sim_ros.gap.planning.next_recording import suggest
    from flexx2_sim_ros.profiles.files import find_profile

    console = Console(stderr=True, markup=False)
    out = Path(arguments.out or arguments.diagnosis)
    check_outputs('--out', out, [_FILE])
    with progress_bar(console) as progress:
        table = suggest(
            arguments.diagnosis,
            profile=find_profile(arguments.profile),
            seed=arguments.seed,
            jobs=arguments.jobs,
            progress=progress,
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

"""`flexx2 gap`: diagnose the sim-to-real gap."""

import argparse
from importlib import import_module
from importlib.util import find_spec
import os
from typing import Any

from flexx2_sim_ros.cli import gap_check, gap_next, gap_plan, gap_target, gap_truth
from flexx2_sim_ros.cli.argument_types import MOST_JOBS, number, whole_number
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.profiles.files import PROFILE_HELP
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


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
    diagnose = subcommands.add_parser(
        'diagnose',
        help='find which effects cause the gap, where it lies and how much they explain',
        description='Find the effects that explain the gap. The result says for example that '
        'an effect removes 61 % of the gap: this fraction of the difference goes away, on '
        'recordings that were not used for the fit, once the effect is simulated. An '
        'alternative explanation is an effect that explains the recordings equally well. '
        'CAMPAIGN is a folder of recordings (.npz or bags) with their ground truth, '
        'clean_depth; each shows one scene. DIR gets report.html, diagnosis.json '
        '(docs/diagnosis.md) and effects.yaml (for flexx2 simulate --effects and the node).',
        epilog='example: flexx2 gap diagnose recordings --out diagnosis --pose-prior 0.005 0.25',
    )
    diagnose.add_argument('campaign', metavar='CAMPAIGN', help='folder of recordings')
    diagnose.add_argument('--out', required=True, metavar='DIR', help='folder for the results')
    diagnose.add_argument('--profile', metavar='NAME', default='', help=PROFILE_HELP)
    diagnose.add_argument(
        '--without',
        action='append',
        default=[],
        metavar='NAME',
        help='do not consider this effect (may be repeated)',
    )
    diagnose.add_argument(
        '--seed',
        type=whole_number(0, 10**9 - 1),
        default=0,
        help='seed of the simulations (default 0)',
    )
    diagnose.add_argument(
        '--jobs',
        type=whole_number(1, MOST_JOBS),
        default=os.cpu_count() or 1,
        help='number of processes (default: one per core)',
    )
    diagnose.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='use the Dask cluster of '
        'this scheduler, e.g. tcp://host:8786; its workers must see the '
        'recordings at the same paths',
    )
    diagnose.add_argument(
        '--pose-prior',
        type=number(0, 1e3, above=True),
        nargs=2,
        default=(0.010, 0.5),
        metavar=('METRES', 'DEGREES'),
        help='how inaccurate the given camera poses are: standard deviations of position and '
        'angle (default 0.01 0.5)',
    )
    diagnose.add_argument('--known', metavar='FILE', help=gap_check.KNOWN_HELP)
    diagnose.set_defaults(run=run_diagnose)
    gap_plan.add_parser(subcommands)
    gap_target.add_parser(subcommands)
    gap_check.add_parser(subcommands)
    gap_next.add_parser(subcommands)
    gap_truth.add_parser(subcommands)
    if find_spec('flexx2_sim_ros.cli.gap_benchmark'):
        import_module('flexx2_sim_ros.cli.gap_benchmark').add_parser(subcommands)


def run_diagnose(arguments: argparse.Namespace) -> int:
    """Diagnose with a progress bar, and print a short result."""
    from flexx2_sim_ros.gap import diagnose
    from flexx2_sim_ros.gap.report.words import headline, remarks, sentences
    from flexx2_sim_ros.profiles.files import find_profile

    console = Console(stderr=True, markup=False)
    with Progress(
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        task = progress.add_task('starting', total=1.0)
        table = diagnose(
            arguments.campaign,
            profile=find_profile(arguments.profile) if arguments.profile else None,
            without=arguments.without,
            seed=arguments.seed,
            jobs=arguments.jobs,
            out=arguments.out,
            pose_prior=tuple(arguments.pose_prior),
            scheduler=arguments.scheduler,
            known=gap_check.read_known(arguments.known),
            progress=lambda text, share: progress.update(task, description=text, completed=share),
        )
    console.print(headline(table), style='bold', highlight=False)
    for line in sentences(table) + remarks(table):
        console.print(printable(line), highlight=False)
    console.print(
        f'{arguments.out}: diagnosis.json, effects.yaml, report.html ({table["seconds"]:.0f} s)',
        highlight=False,
    )
    return 0

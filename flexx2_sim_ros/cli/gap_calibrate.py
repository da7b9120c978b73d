"""`flexx2 gap calibrate`: fit curves and maps of the diagnosed effects to recordings."""

import argparse
from typing import Any

from flexx2_sim_ros.cli.common import (
    add_diagnosis,
    add_out,
    add_scheduler,
    add_simulation,
    print_lines,
    progress_bar,
)
from rich.console import Console


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'calibrate',
        description='A diagnosis fits those forms of its effects that are quick to fit. This '
        'command fits all, and tries alternative explanations as well: a bias over range, '
        'amplitude or time, a probability of invalid pixels over incidence or amplitude, a map of '
        'a fixed pattern, widths, gates and frequencies. A form is taken only if it brings the '
        'simulation nearer to recordings that it was not fitted to; otherwise the effect stays as '
        'it was diagnosed. Writes effects.yaml (with maps as .npz files beside it), '
        'calibration.json, calibration.html and diagnosis.json, so that flexx2 gap check can use '
        'the folder.',
        epilog='example: flexx2 gap calibrate diagnosis/ recordings/ --out calibrated/',
    )
    add_diagnosis(parser)
    parser.add_argument(
        'campaign',
        metavar='CAMPAIGN',
        help='folder of recordings with clean_depth, three or more: those of the diagnosis or '
        'others of the same camera',
    )
    add_out(parser)
    add_simulation(parser)
    add_scheduler(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate with a progress bar, and print the forms that were taken."""
    from flexx2_sim_ros.gap import calibrate
    from flexx2_sim_ros.gap.report.calibration_page import FILES, headline, sentences
    from flexx2_sim_ros.profiles.files import find_profile

    console = Console(stderr=True, markup=False)
    with progress_bar(console) as progress:
        table = calibrate(
            arguments.diagnosis,
            arguments.campaign,
            profile=find_profile(arguments.profile),
            seed=arguments.seed,
            jobs=arguments.jobs,
            out=arguments.out,
            scheduler=arguments.scheduler,
            progress=progress,
        )
    console.print(headline(table), style='bold', highlight=False)
    print_lines(console, sentences(table))
    console.print(
        f'{arguments.out}: {", ".join(FILES)} ({table["seconds"]:.0f} s)', highlight=False
    )
    return 0

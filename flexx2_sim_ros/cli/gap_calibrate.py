"""`flexx2 gap calibrate`: fit curves and maps of the diagnosed effects to recordings."""

import argparse

from flexx2_sim_ros.cli import common


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.description = (
        'A diagnosis fits those forms of its effects that are quick to fit. This '
        'command fits all, and tries alternative explanations as well: a bias over range, '
        'amplitude or time, a probability of invalid pixels over incidence or amplitude, a map of '
        'a fixed pattern, widths, gates and frequencies. A form is taken only if it brings the '
        'simulation nearer to recordings that it was not fitted to; otherwise the effect stays as '
        'it was diagnosed. Writes effects.yaml (with maps as .npz files beside it), '
        'calibration.json, calibration.html and diagnosis.json, so that flexx2 gap check can use '
        'the folder.'
    )
    parser.epilog = 'example: flexx2 gap calibrate diagnosis/ recordings/ --out calibrated/'
    common.add_diagnosis(parser)
    parser.add_argument(
        'campaign',
        metavar='CAMPAIGN',
        help='folder of recordings with clean_depth, three or more: those of the diagnosis or '
        'others of the same camera',
    )
    common.add_out(parser)
    common.add_simulation(parser)
    common.add_scheduler(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate with a progress bar, and print the forms that were taken."""
    from flexx2_sim_ros.gap import calibrate
    from flexx2_sim_ros.gap.report.calibration_page import FILES, headline, sentences

    console = common.messages()
    with common.progress_bar(console) as progress:
        table = calibrate(
            arguments.diagnosis,
            arguments.campaign,
            **common.simulation(arguments),
            out=arguments.out,
            progress=progress,
        )
    console.print(headline(table), style='bold')
    common.print_lines(console, sentences(table))
    console.print(f'{arguments.out}: {", ".join(FILES)} ({table["seconds"]:.0f} s)')
    return 0

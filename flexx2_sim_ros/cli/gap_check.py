"""`flexx2 gap check`: check a diagnosis on recordings that it has never seen."""

import argparse
from typing import Any

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.errors import printable
from rich.console import Console
from rich.table import Column

OPTIONS = """
Compare the recordings in FRESH with their simulation, before and after the effects of
DIAGNOSIS/effects.yaml are simulated. Prints a table with 90 % intervals over recordings, and
writes check.json and check.html. The exit status is 0 if the gap shrinks and no physical measure
gets significantly worse, 1 if not, and 2 if something cannot be used. Recordings that were part of
the diagnosis are refused.

diagnosis
fresh FRESH: folder of recordings with clean_depth (.npz or bags)
--out DIR: folder for the results (default: DIAGNOSIS)
--json: print check.json to standard output, and no table
--known FILE: effects taken as given (a file as for flexx2 simulate --effects): the simulation has
    them, and only the rest of the gap is looked at, e.g. after a firmware update or with a filter
    switched on (default: as in the diagnosis)
--profile
--seed
--jobs
--scheduler
--pose-prior METRES DEGREES: how inaccurate the given camera poses are: standard deviations of
    position and angle (default: as in the diagnosis)

example: flexx2 gap check diagnosis/ fresh/ --out checked/
"""
VALUES = {'pose_prior': number(0, 1e3, above=True)}


def run(arguments: argparse.Namespace) -> int:
    """Check with a progress bar; print the table or JSON."""
    from flexx2_sim_ros.gap import check

    out = arguments.out or arguments.diagnosis
    known = common.read_known(arguments.known)
    written = f'{out}: check.json, check.html'
    table = common.call_and_print(check, arguments, written, _show, out=out, known=known)
    return 0 if table['holds'] else 1


def _show(table: dict[str, Any], console: Console) -> None:
    from flexx2_sim_ros.gap.report.check_page import headline, HEADS, lines, sentences

    console.print(printable(headline(table)), style='bold')
    heads = Column(overflow='fold'), *HEADS[1:-1], ''
    # A value above its interval, so that the table fits a terminal of 80 columns.
    rows = ([text.replace(' (', '\n(') for text in line] for line in lines(table))
    console.print(common.ruled_table(heads, rows, padding=(0, 1, 0, 0)))
    common.print_lines(console, sentences(table))

"""`flexx2 gap cost`: measure what a gap costs on a robot."""

import argparse
from typing import Any

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.limits import CONSUMER_SECONDS
from rich.console import Console
from rich.table import Column

OPTIONS = f"""
Send the recordings in CAMPAIGN and their simulations (as simulated, with each diagnosed effect,
with all) through what reads depth on a robot: a height grid, an elevation map, an occupancy map,
the distance of obstacles, or your own. Writes cost.json and cost.html.

campaign CAMPAIGN: folder of recordings with clean_depth
--diagnosis DIR: folder that flexx2 gap diagnose has written
--out
--consumer NAME: what reads depth: a name, or a class in a Python file such as my.py:Grid; can be
    given several times (default: all that are installed)
--mounting METRES DEGREES: height of the camera above the ground and angle by which it looks down
    (default: from the ground in the ground truth)
--limit SECONDS: how long a consumer may take for a recording (default {CONSUMER_SECONDS:g})
--json: print cost.json to standard output, and no table
--profile
--seed
--jobs

example: flexx2 gap cost recordings/ --diagnosis diagnosis/ --out cost/
"""
VALUES = {
    'diagnosis': {'required': True},
    'consumer': {'action': 'append', 'default': []},
    'mounting': number(-1e3, 1e3),
    'limit': {'type': number(0, 1e6, above=True), 'default': CONSUMER_SECONDS},
}


def run(arguments: argparse.Namespace) -> int:
    """Measure with a progress bar; print the table or JSON."""
    from flexx2_sim_ros.gap import cost

    written = f'{arguments.out}: cost.json, cost.html'
    own = {'campaign_dir': arguments.campaign, 'consumers': arguments.consumer}
    common.call_and_print(cost, arguments, written, _show, **own)
    return 0


def _show(table: dict[str, Any], console: Console) -> None:
    from flexx2_sim_ros.gap.report.cost_page import (
        headline,
        lines,
        NOTHING_SEEN,
        RANKING,
        ranking,
        sentences,
    )
    from flexx2_sim_ros.gap.report.text import spaced

    console.print(printable(headline(table)), style='bold')
    if table['ranking']:
        console.print(common.ruled_table(RANKING, ranking(table), padding=(0, 1, 0, 0)))
    heads = Column(overflow='fold'), 'recorded', 'simulated', 'all effects', 'taken away first'
    shown = common.ruled_table(heads, padding=(0, 1, 0, 0))
    for consumer in table['consumers']:
        shown.add_row(printable(spaced(consumer['name'])), style='bold')
        for line, significant in lines(consumer):
            texts = [printable(text).replace(' (', '\n(') for text in line]
            shown.add_row(*texts, style='' if significant else 'dim')
        if not consumer['measures']:
            shown.add_row(NOTHING_SEEN, style='dim')
    console.print(shown)
    common.print_lines(console, sentences(table))

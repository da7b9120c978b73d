"""`flexx2 gap next`: rank recordings by how well they settle what a diagnosis leaves open."""

import argparse
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import as_json, check_outputs, write_texts
from flexx2_sim_ros.cli import common
from rich.table import Column, Table

_FILE, _PAGE = 'next.json', 'next.html'
_ROWS = 10
OPTIONS = f"""
Simulate the explanations that DIAGNOSIS leaves open in recordings that you could make next, and
diagnose each together with the recordings of CAMPAIGN. The ranking says how often that names the
right cause. Prints the suggestion and the ranking, and writes {_FILE} and {_PAGE} with pictures of
what each explanation would look like. For some causes no set-up of the plan is enough. How often a
suggestion came true on a blind camera is in docs/diagnose_your_flexx2.md.

diagnosis
campaign CAMPAIGN: folder of the recordings that were diagnosed
--out DIR: folder for the results (default: DIAGNOSIS)
--plan FILE: what could be recorded (default: config/gap_plan.yaml)
--truth KIND: ground truth that you can make: exact, scan, planes, tape or laser (may be repeated).
    Default: scan if the poses of the campaign come from a scan, tape and laser if it has planes,
    otherwise exact
--scene FILE: a scene of your own to rank as well: an .npz file as for flexx2 simulate (may be
    repeated)
--profile
--seed
--jobs

example: flexx2 gap next diagnosis/ campaign/ --truth tape
"""
VALUES = {
    'out': {'required': False},
    'plan': Path,
    'truth': {'action': 'append', 'default': []},
    'scene': {'action': 'append', 'default': []},
}


def run(arguments: argparse.Namespace) -> int:
    """Rank recordings with a progress bar, print the ranking and write the page."""
    # Imported here: matplotlib and the compiled camera take seconds to load.
    from flexx2_sim_ros.gap.planning.next_recording import suggest
    from flexx2_sim_ros.gap.planning.page import suggested, suggestions
    from flexx2_sim_ros.gap.planning.plan import read_plan
    from flexx2_sim_ros.profiles.files import find_profile

    console = common.messages()
    out = Path(arguments.out or arguments.diagnosis)
    check_outputs('--out', out, [_FILE, _PAGE])
    profile = find_profile(arguments.profile)
    with common.progress_bar(console) as progress:
        table, views = common.call(
            suggest,
            arguments,
            plan=read_plan(arguments.plan),
            kinds=arguments.truth,
            scenes=arguments.scene,
            profile=profile,
            progress=progress,
        )
    write_texts(out, {_FILE: as_json(table), _PAGE: suggestions(table, views, profile.intrinsics)})
    console.print(_shown(table))
    common.print_lines(console, [suggested(table)])
    console.print(f'{out}: {_FILE}, {_PAGE}')
    return 0


def _shown(table: dict[str, Any]) -> Table:
    from flexx2_sim_ros.gap.planning.page import baselines
    from flexx2_sim_ros.gap.report.text import percent

    def shares(row: Any) -> list[str]:
        return [percent(row[key]) for key in ('right', 'wrong', 'undecided')]

    heads = Column('record', no_wrap=True), 'truth', 'correct', 'wrong', 'open'
    rows = ([row['name'], row['truth'], *shares(row)] for row in table['ranking'][:_ROWS])
    shown = common.ruled_table(heads, rows, pad_edge=False)
    shown.add_section()
    for words, row in baselines(table):
        shown.add_row(words, '', *shares(row))
    return shown

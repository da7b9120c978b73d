"""`flexx2 gap diagnose`: find out why recordings differ from the simulation."""

import argparse
from pathlib import Path

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.options import number

_COMPILING = 'compiling: takes a minute or two, once (flexx2 compile does it ahead) ...'
OPTIONS = """
Find the effects that explain the gap. The result says for example that an effect removes 61 % of
the gap: this fraction of the difference goes away, on recordings that were not used for the fit,
once the effect is simulated. An alternative explanation is another effect that may be present: the
recordings do not rule it out. CAMPAIGN is a folder of recordings (.npz or bags) with their ground
truth, clean_depth; each shows one scene. DIR gets report.html, diagnosis.json (docs/diagnosis.md)
and effects.yaml (for flexx2 simulate --effects and the node), with curves, tables and maps as the
recordings show them.

campaign CAMPAIGN: folder of recordings
--out
--without NAME: do not consider this effect (may be repeated)
--profile
--seed
--jobs
--scheduler
--pose-prior METRES DEGREES: how inaccurate the given camera poses are: standard deviations of
    position and angle (default: as they seem to be)
--known
--forms catalogue|quick|all: curves, tables, maps and numbers of the named effects that are fitted:
    none, those that need few simulations (default), or all, which takes minutes for each effect
--cost: measure what the gap costs a robot as well, as flexx2 gap cost does; the report gets a
    section about it
--process CHAIN.yaml: measure as well how much of the gap is left after the robot's own processing
    of depth, on both sides (docs/recordings.md); the recordings are unprocessed

example: flexx2 gap diagnose recordings --out diagnosis
"""
VALUES = {
    'without': {'action': 'append', 'default': []},
    'pose_prior': number(0, 1e3, above=True),
    'forms': 'quick',
    'process': Path,
}


def run(arguments: argparse.Namespace) -> int:
    """Diagnose with a progress bar, and print a short result."""
    from flexx2_sim_ros.camera.compiling import compiling_said
    from flexx2_sim_ros.gap import diagnose
    from flexx2_sim_ros.gap.report.age import age_words
    from flexx2_sim_ros.gap.report.cost_page import in_short as cost_in_short
    from flexx2_sim_ros.gap.report.sizes import attribution, HEADS, processed_in_short, said
    from flexx2_sim_ros.gap.report.words import (
        headline,
        not_considered,
        on_recordings,
        significance,
    )
    from flexx2_sim_ros.processing import load_chain

    console = common.messages()
    compiling = compiling_said(lambda: console.print(_COMPILING))
    with common.progress_bar(console) as progress, compiling:
        table = common.call(
            diagnose,
            arguments,
            campaign_dir=arguments.campaign,
            known=common.read_known(arguments.known),
            process=arguments.process and load_chain(arguments.process),
            progress=progress,
        )
    console.print(headline(table), style='bold')
    common.print_lines(console, significance(table))
    if table['effects']:
        console.print(common.ruled_table(HEADS, attribution(table), pad_edge=False))
    lines = [*said(table)[0], *age_words(table['age'])]
    lines += [*not_considered(table), *on_recordings(table['recordings'])]
    common.print_lines(console, dict.fromkeys(lines))
    if arguments.process:
        common.print_lines(console, [processed_in_short(table)])
    if arguments.cost:
        common.print_lines(console, [cost_in_short(table['cost'])])
    console.print(
        f'{arguments.out}: diagnosis.json, effects.yaml, report.html ({table["seconds"]:.0f} s)'
    )
    return 0

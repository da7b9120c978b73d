"""`flexx2 gap plan`: write what to record, and which effects these recordings can find."""

import argparse
from dataclasses import replace
from pathlib import Path

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.options import whole_number

CHECKLIST, PAGE, FORM, TABLE = 'checklist.md', 'plan.html', 'planes.yaml', 'table.yaml'
OPTIONS = f"""
Write a checklist for one hour with a camera: what to set up, which command records it, and what
ground truth it needs; a form for the distances that you measure; and a table of how weak an effect
may be and still be found. See docs/diagnose_your_flexx2.md.

--out DIR: gets {CHECKLIST}, {PAGE}, {FORM}
--plan FILE: your own plan (default: config/gap_plan.yaml)
--usecase MODE: mode to record in (default: the plan's; of the shipped plan, the camera's usual one
    if it lacks that)
--compute: compute the table for this plan and camera, and write it to {TABLE}. Takes about ten
    minutes; an interrupted run resumes
--profile
--seed
--jobs

example: flexx2 gap plan --out plan/
"""
VALUES = {'out': {'required': True}, 'plan': Path, 'seed': whole_number(0, 10**6)}


def run(arguments: argparse.Namespace) -> int:
    """Write the checklist, the page and, if asked for, the table."""
    # Imported here: matplotlib and the compiled camera take seconds to load.
    from flexx2_sim_ros import atomic
    from flexx2_sim_ros.gap.planning.page import Checklist, form, markdown, page
    from flexx2_sim_ros.gap.planning.plan import read_plan
    from flexx2_sim_ros.gap.planning.power import compute, PowerRequest, shipped_table, to_yaml
    from flexx2_sim_ros.profiles.files import find_profile

    plan = read_plan(arguments.plan)
    profile = find_profile(arguments.profile)
    if arguments.usecase is not None:
        plan = replace(plan, usecase=profile.mode(arguments.usecase).name)
    elif not arguments.plan and plan.usecase not in profile.names:
        plan = replace(plan, usecase=profile.default_usecase)
    profile.mode(plan.usecase)
    out = atomic.output_folder(arguments.out)
    console = common.messages()
    if arguments.compute:
        request = PowerRequest(plan, profile, out, arguments.seed, jobs=arguments.jobs)
        with common.progress_bar(console) as progress:
            table = compute(request, common.command_line('gap', 'plan'), progress)
    else:
        table = shipped_table()
    shipped = not (arguments.plan or arguments.profile or arguments.usecase)
    told = Checklist(plan, profile, table, shipped or arguments.compute, arguments.profile)
    texts = {CHECKLIST: markdown(told), PAGE: page(told)}
    if arguments.compute:
        texts[TABLE] = to_yaml(table)
    if not (out / FORM).exists():  # It may have been filled in.
        texts[FORM] = form(plan)
    atomic.write_texts(out, texts)
    console.print(f'{out}: {", ".join(texts)}')
    return 0

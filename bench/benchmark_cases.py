"""
Single development cases of `flexx2 gap benchmark`, with predicted and realised reduction.

The whole development run takes hours; this runs the cases of some effects and strengths alone. It
prints what the diagnosis said, whether the first row of `where` is of the effect's physics, which
reduction it predicts, which one happens on fresh scenes, and the time on one core. Cases that the
same code has answered in ``--out`` are not run again.

With ``--inside``, all cameras have these values of `Internals` beside their own.

python -m bench.benchmark_cases --effects intrinsics_error,wiggling --strengths 1 --jobs 2
"""

import argparse
from concurrent.futures import as_completed
from dataclasses import replace
import json
from pathlib import Path

from flexx2_sim_ros import processes
from flexx2_sim_ros.atomic import output_folder
from study.benchmark.answers import code_digest
from study.benchmark.design import make_design
from study.benchmark.physics import is_physical
from study.benchmark.runner import DIAGNOSE, MEASURE, run_case
from study.benchmark.seeds import DEVELOPMENT


def main():
    """Run the chosen cases and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--effects', required=True, help='names; none: cases without an effect')
    parser.add_argument('--strengths', default='1')
    parser.add_argument('--groups', default='single,none')
    parser.add_argument('--pose-mm', type=float, default=2.0)
    parser.add_argument('--inside', type=json.loads, default={}, help='JSON: values by field')
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--out', default='build/benchmark_cases')
    arguments = parser.parse_args()
    out = Path(arguments.out) / code_digest()[:8]
    cases = dict(_chosen(arguments))
    if not cases:
        parser.error(
            '--effects: must be in cases of these --strengths, --groups and --pose-mm, got '
            f'{arguments.effects}'
        )
    results = output_folder(out / 'results')
    left = [
        (out, name, planned.to_json())
        for name, planned in cases.items()
        if not (results / f'{name}.json').is_file()
    ]
    with processes.workers(arguments.jobs, one_thread=True) as submit:
        for future in as_completed(submit(_run, left)):
            print(f'ran {future.result()}', flush=True)
    for name, planned in cases.items():
        print(_line(name, planned, json.loads((results / f'{name}.json').read_text())))


def _chosen(arguments):
    names = set(arguments.effects.split(','))
    strengths = {float(one) for one in arguments.strengths.split(',')}
    groups = set(arguments.groups.split(','))
    for planned in make_design(DEVELOPMENT, quick=False):
        if (
            planned.group not in groups
            or planned.pose_mm != arguments.pose_mm
            or (planned.effects and planned.strength not in strengths)
            or not names & (set(planned.effects) or {'none'})
        ):
            continue
        told = '+'.join(planned.effects) or 'none'
        scene = f'{planned.seed}-{planned.scene_seed}'
        name = f'{planned.group}-{told}-{planned.strength:g}-{scene}'
        name += ''.join(f'-{field}={value}' for field, value in arguments.inside.items())
        inside = {**planned.internals, **arguments.inside}
        realise = bool(planned.effects) and not planned.without
        yield name, replace(planned, internals=inside, realise=realise)


def _run(call):
    run_case(*call, DIAGNOSE, MEASURE)
    return call[1]


def _line(name, planned, result):
    table = result['diagnosis']
    if table is None:
        return f'{name:45s} {result["error"].splitlines()[-1]}'
    where = '-'
    if table['where']:
        first = table['where'][0]['covariate']
        where = f'{first} ({"right" if is_physical(first, planned.effects) else "WRONG"})'
    gap, realised = table['gap'] or {}, result['realised'] or {}
    named = ', '.join(f'{row["name"]} {row["confidence"]:.2f}' for row in table['effects'])
    return (
        f'{name:45s} {table["verdict"]:10s} where {where:22s} '
        f'predicted {_number(gap.get("shrink"))} realised {_number(realised.get("shrink"))} '
        f'{result["cpu_seconds"]:5.1f} s  {named}'
    )


def _number(value):
    return '  - ' if value is None else f'{value:.2f}'


if __name__ == '__main__':
    main()

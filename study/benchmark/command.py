"""`flexx2 gap benchmark`: the diagnosis tested on an independent camera."""

import argparse
from pathlib import Path

from flexx2_sim_ros.cli.common import call, command_line
from flexx2_sim_ros.cli.options import MOST_JOBS, whole_number
from rich.console import Console

_CONFUSION = 'benchmark_confusion.png'
_ANSWERS = 'answers.jsonl'


OPTIONS = f"""
Record campaigns with a blind camera, whose physics is separate from the simulator, diagnose each,
and score the answers against labels that were sealed before the run. Resumes after an
interruption. Prints the tables and writes benchmark.md, {_CONFUSION} and {_ANSWERS} to --out.

--quick: a few small cases, in minutes
--seed-set dev|test: which seeds of scenes and cameras (default %(default)s)
--release: allow the test seeds; for the published run of a release only
--jobs JOBS: number of processes (default %(default)s)
--out OUT: folder for results, labels and cache (default %(default)s)
--score: run nothing: score the finished cases of an interrupted run
--earlier FILE: {_ANSWERS} of an earlier part of this run, with the same version: its cases are not
    run again, and all are scored together

example: flexx2 gap benchmark --quick --out /tmp/benchmark
"""
VALUES = {
    'seed_set': 'dev',
    'jobs': {'type': whole_number(1, MOST_JOBS), 'default': 2},
    'out': 'benchmark_output',
}


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark; print and write its results."""
    # Imported here: scikit-learn, matplotlib and the compiled camera take seconds to load.
    from study.benchmark.answers import joined, read_answers, write_answers
    from study.benchmark.report import draw_confusion, print_report, write_page
    from study.benchmark.runner import run_benchmark
    from study.benchmark.scoring import score, Scores

    out = Path(arguments.out)
    earlier = read_answers(Path(arguments.earlier)) if arguments.earlier else None
    if arguments.score:
        scores: Scores | None = score(out, partly=True)
    else:
        console = Console(stderr=True, markup=False)
        scores = call(run_benchmark, arguments, out=out, earlier=earlier, console=console)
    if scores is None:
        return 1
    scores = joined(earlier, scores)
    print_report(scores, Console(markup=False))
    draw_confusion(scores, out / _CONFUSION)
    write_answers(scores, out / _ANSWERS)
    write_page(scores, out / 'benchmark.md', command_line('gap', 'benchmark'), _CONFUSION)
    return 0

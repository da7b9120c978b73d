"""`flexx2 gap benchmark`: the diagnosis against a camera it knows nothing of."""

import argparse
from pathlib import Path
import shlex
import sys
from typing import Any

from flexx2_sim_ros.cli.argument_types import MOST_JOBS, whole_number
from rich.console import Console

_CONFUSION = 'benchmark_confusion.png'


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'benchmark',
        help='score the diagnosis on a camera it knows nothing of',
        description='Record campaigns with a blind camera (raw correlation samples, effects on '
        'phasors and taps), have each diagnosed, and score the answers against labels that were '
        'sealed before the run. Goes on where it was broken off. Prints the tables and writes '
        f'benchmark.md and {_CONFUSION} to --out.',
        epilog='example: flexx2 gap benchmark --quick --out /tmp/benchmark',
    )
    parser.add_argument('--quick', action='store_true', help='a few small cases, in minutes')
    parser.add_argument(
        '--seed-set',
        choices=('dev', 'test'),
        default='dev',
        help='seeds of scenes and cameras (default %(default)s)',
    )
    parser.add_argument(
        '--release',
        action='store_true',
        help='allow the test seeds: for the run that is published',
    )
    parser.add_argument(
        '--jobs',
        type=whole_number(1, MOST_JOBS),
        default=2,
        help='processes (default %(default)s)',
    )
    parser.add_argument(
        '--out',
        default='benchmark_output',
        help='folder for results, labels and cache (default %(default)s)',
    )
    parser.add_argument(
        '--score',
        action='store_true',
        help='run nothing: score what is done of a run that was broken off',
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run, print, write."""
    # Imported here: scikit-learn, matplotlib and the compiled camera take seconds to load.
    from flexx2_sim_ros.validation.benchmark.report import draw_confusion, print_report, write_page
    from flexx2_sim_ros.validation.benchmark.runner import run_benchmark
    from flexx2_sim_ros.validation.benchmark.scoring import score, Scores

    out = Path(arguments.out)
    if arguments.score:
        scores: Scores | None = score(out, partly=True)
    else:
        scores = run_benchmark(
            out,
            quick=arguments.quick,
            seed_set=arguments.seed_set,
            release=arguments.release,
            jobs=arguments.jobs,
            console=Console(stderr=True, markup=False),
        )
    if scores is None:
        return 1
    print_report(scores, Console(markup=False))
    draw_confusion(scores, out / _CONFUSION)
    words = sys.argv[1:] or ['gap', 'benchmark']
    write_page(scores, out / 'benchmark.md', shlex.join(['flexx2', *words]), _CONFUSION)
    return 0

"""
Measure how long a user waits for a diagnosis, with all cores at work on it.

`flexx2 gap benchmark` runs several diagnoses at a time, each on one core. This runs one at a time
with ``--jobs`` processes, on a random sample of the benchmark's cases with development seeds, and
prints the elapsed time of each, from start to report. Nothing else should run.

python -m bench.gap_elapsed --cases 16 --jobs 2
"""

import argparse
import time

from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.validation.benchmark.design import make_design, Planned
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
from flexx2_sim_ros.validation.blind import BlindCamera
import numpy as np


def main() -> None:
    """Print the elapsed time of each case, their median and the largest."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--cases', type=int, default=16)
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--seed', type=int, default=0, help='of the sample')
    arguments = parser.parse_args()
    cases = make_design(DEVELOPMENT, quick=False)
    order = np.random.default_rng(arguments.seed).permutation(len(cases))
    _elapsed(cases[order[-1]], arguments.jobs)  # reads what is compiled
    elapsed = []
    for index in order[: arguments.cases]:
        seconds, verdict = _elapsed(cases[index], arguments.jobs)
        effects = '+'.join(cases[index].effects) or 'none'
        print(f'{cases[index].group:10s} {effects:36s} {verdict:12s} {seconds:5.1f} s', flush=True)
        elapsed.append(seconds)
    print(f'median {np.median(elapsed):.1f} s, slowest {max(elapsed):.1f} s of {len(elapsed)}')


def _elapsed(case: Planned, jobs: int) -> tuple[float, str]:
    # Seconds of one diagnosis, report included, and its verdict.
    with scratch_folder() as folder:
        campaign = folder / 'campaign'
        campaign.mkdir()
        BlindCamera(case.case).record(campaign)
        start = time.perf_counter()
        table = diagnose(campaign, without=case.without, jobs=jobs, out=folder / 'out')
        return time.perf_counter() - start, table['verdict']


if __name__ == '__main__':
    main()

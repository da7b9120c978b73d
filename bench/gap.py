"""Time and memory of a diagnosis, by the number of recordings and frames; that of the first."""

import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

from bench.gap_campaigns import write_campaign
from bench.timing import peak_megabytes
from flexx2_sim_ros.gap import diagnose
import numpy as np

# Recordings and frames, 224 x 172; first those of the usual campaign.
_SIZES = ((8, 20), (4, 20), (8, 10), (8, 40), (16, 20))


def run(sizes=_SIZES):
    """Print time and memory."""
    usual = sizes[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for recordings, frames in sizes:
            write_campaign(
                folder / f'{recordings}x{frames}',
                seed=7,
                recordings=recordings,
                frames=frames,
                moving=recordings * 3 // 8,
                effects={'wiggling': {}},
            )
        first = folder / f'{usual[0]}x{usual[1]}'
        _print_first(first, folder)
        diagnose(first)  # compiles
        cost = {}
        for recordings, frames in sizes:
            start = time.process_time()
            diagnose(folder / f'{recordings}x{frames}')
            cost[recordings, frames] = time.process_time() - start
        unit = cost[usual]
        print(
            f'{usual[0]} recordings of {usual[1]} frames: {unit:.1f} s of a core; others in '
            'units of that'
        )
        for (recordings, frames), seconds in cost.items():
            print(f'  {recordings:2d} recordings of {frames} frames: {seconds / unit:.2f}')
        start = time.perf_counter()
        diagnose(first, jobs=2)
        print(
            f'two processes: {time.perf_counter() - start:.1f} s (wanted: 30 s); largest '
            f'resident memory of one: {peak_megabytes():.0f} MB (wanted: 2,000 MB)'
        )


def _print_first(recordings, folder):
    # Twice in processes of their own; only before the first one nothing is compiled.
    spent = [_children_seconds()]
    for number in range(2):
        subprocess.run(
            [sys.executable, '-m', 'flexx2_sim_ros.cli.main', 'gap', 'diagnose', str(recordings)]
            + ['--out', str(folder / f'diagnosis_{number}'), '--jobs', '1'],
            env={**os.environ, 'NUMBA_CACHE_DIR': str(folder / 'compiled')},
            capture_output=True,
            check=True,
        )
        spent.append(_children_seconds())
    first, second = np.diff(spent)
    print(
        f'the first diagnosis: {first:.0f} s of a core, {first - second:.0f} s of it to compile; '
        'wanted: 22 s'
    )


def _children_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

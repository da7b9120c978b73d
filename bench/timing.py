"""Time several functions side by side; what processes use."""

from contextlib import contextmanager
import os
from pathlib import Path
import re
import resource
import statistics
import time


@contextmanager
def one_core():
    """Keep this process on one core within the block."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def side_by_side(functions, rounds, clock=time.perf_counter):
    """
    Return the median milliseconds of each function; they are called in turns.

    Other load on the machine then affects all functions alike. With ``clock=time.process_time``
    only their own CPU time counts.
    """
    for function in functions.values():
        function()
    times = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            start = clock()
            function()
            times[name].append(clock() - start)
    return {name: 1e3 * statistics.median(values) for name, values in times.items()}


def peak_megabytes():
    """Return the largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def cpu_seconds(pid):
    """Return the CPU time that a process has used."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def megabytes(pid):
    """Return the memory of a process, MB, NaN when it has ended; what several share is divided."""
    try:
        text = Path(f'/proc/{pid}/smaps_rollup').read_text()
    except OSError:
        return float('nan')
    return sum(map(int, re.findall(r'^Pss:\s+(\d+)', text, re.M))) / 1024

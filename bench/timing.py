"""Time several functions side by side."""

from contextlib import contextmanager
import os
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

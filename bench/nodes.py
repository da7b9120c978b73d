"""Two cameras fed at 60 Hz each, in two processes and in one: gaps, latency, CPU and memory."""

from dataclasses import dataclass
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import numpy as np

_CAMERAS = ('left', 'right')
_RATE = 60


@dataclass(frozen=True)
class _Cost:
    # Of all processes: CPU seconds for each frame that arrived, MB.
    cpu: float
    memory: float


def run(seconds=20):
    """Print how many frames arrived, and how fast; what one process for both takes."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    print(
        f'two cameras at Mode_5_60fps, fed at {_RATE} Hz each for {seconds} s, '
        f'{len(os.sched_getaffinity(0))} cores'
    )
    two = _run([[name] for name in _CAMERAS], seconds)
    one = _run([list(_CAMERAS)], seconds)
    print('wanted: no gaps, p99 below 10 ms')
    print(
        f'one process instead of two: {one.memory / two.memory:.2f} times the memory, '
        f'{one.cpu / two.cpu:.2f} times the CPU for each frame'
    )


def _run(groups, seconds):
    # Each group of cameras in a process of its own.
    node = [sys.executable, '-m', 'flexx2_sim_ros.nodes.flexx2_camera']
    options = ['--ros-args', '-p', 'usecase:=Mode_5_60fps', '--log-level', 'warn']
    processes = [subprocess.Popen([*node, *names, *options]) for names in groups]
    try:
        return _measure(processes, seconds)
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            process.wait(10)


def _measure(processes, seconds):
    # ROS is imported where it is needed: other measurements run without it.
    from bench.node_traffic import Traffic
    import rclpy

    def used():
        return sum(cpu_seconds(process.pid) for process in processes)

    rclpy.init(args=[])
    try:
        traffic = Traffic(_CAMERAS, _RATE)
        traffic.wait_for_nodes()
        before, own, start = used(), time.process_time(), time.perf_counter()
        traffic.feed(_RATE * seconds)
        elapsed = time.perf_counter() - start
        own = time.process_time() - own
        spent = used() - before
        cost = _Cost(
            spent / len(traffic.latencies), sum(megabytes(process.pid) for process in processes)
        )
    finally:
        rclpy.shutdown()
    print(
        f'{len(processes)} processes: {spent / elapsed:.1%} of a core, {cost.memory:.0f} MB (this '
        f'publisher and receiver: {own / elapsed:.1%} of a core); '
        f'{before / len(processes):.2f} s of a core each to start'
    )
    for name, stamps in traffic.stamps.items():
        gaps = int((np.diff(stamps) > 1.5e9 / _RATE).sum())
        print(f'  {name:6s} {len(stamps)} of {_RATE * seconds} frames, {gaps} gaps')
    latency = 1e3 * np.array(traffic.latencies)
    print(
        '  latency from publishing to receiving, ms: '
        + ', '.join(
            f'{text} {np.percentile(latency, q):.2f}'
            for text, q in (('median', 50), ('p90', 90), ('p99', 99), ('max', 100))
        )
    )
    return cost


def cpu_seconds(pid):
    """Return the CPU time that a process has used."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def megabytes(pid):
    """Return the memory of a process, MB; what several share is divided among them."""
    text = Path(f'/proc/{pid}/smaps_rollup').read_text()
    return sum(map(int, re.findall(r'^Pss:\s+(\d+)', text, re.M))) / 1024

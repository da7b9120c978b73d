"""Two camera nodes fed at 60 Hz each: gaps, latency, CPU and memory."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np

_CAMERAS = ('left', 'right')
_RATE = 60


def run(seconds: int = 20) -> None:
    """Print how many frames arrived, and how fast."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    processes = {
        name: subprocess.Popen(
            [
                sys.executable,
                '-m',
                'flexx2_sim_ros.nodes.flexx2_camera',
                '--ros-args',
                '-r',
                f'__ns:=/{name}',
                '-p',
                'usecase:=Mode_5_60fps',
                '--log-level',
                'warn',
            ]
        )
        for name in _CAMERAS
    }
    try:
        _measure(processes, seconds)
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGTERM)
        for process in processes.values():
            process.wait(10)


def _measure(processes: dict[str, subprocess.Popen[bytes]], seconds: int) -> None:
    # ROS is imported where it is needed: other measurements run without it.
    from bench.node_traffic import Traffic
    import rclpy

    rclpy.init(args=[])
    try:
        traffic = Traffic(_CAMERAS, _RATE)
        traffic.wait_for_nodes()
        before = {name: cpu_seconds(process.pid) for name, process in processes.items()}
        own, start = time.process_time(), time.perf_counter()
        traffic.feed(_RATE * seconds)
        elapsed = time.perf_counter() - start
        own = time.process_time() - own
        print(
            f'two cameras at Mode_5_60fps, fed at {_RATE} Hz each for {seconds} s, '
            f'{len(os.sched_getaffinity(0))} cores'
        )
        for name, process in processes.items():
            gaps = int((np.diff(traffic.stamps[name]) > 1.5e9 / _RATE).sum())
            cpu = (cpu_seconds(process.pid) - before[name]) / elapsed
            print(
                f'{name:6s} {len(traffic.stamps[name])} of {_RATE * seconds} frames, '
                f'{gaps} gaps, {cpu:.1%} of a core, '
                f'peak memory {resident_megabytes(process.pid):.0f} MB'
            )
        latency = 1e3 * np.array(traffic.latencies)
        print(
            'latency from publishing to receiving, ms: '
            + ', '.join(
                f'{text} {np.percentile(latency, q):.2f}'
                for text, q in (('median', 50), ('p90', 90), ('p99', 99), ('max', 100))
            )
        )
        print(f'(this publisher and receiver: {own / elapsed:.1%} of a core)')
        print('wanted: no gaps, p99 below 10 ms')
    finally:
        rclpy.shutdown()


def cpu_seconds(pid: int) -> float:
    """Return the CPU time that a process has used."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def resident_megabytes(pid: int) -> float:
    """Return the largest resident memory of a process so far, MB."""
    for line in Path(f'/proc/{pid}/status').read_text().splitlines():
        if line.startswith('VmHWM'):
            return int(line.split()[1]) / 1024
    return float('nan')

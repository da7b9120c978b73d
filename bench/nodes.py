"""
Cameras fed at 60 Hz each: gaps, latency, CPU and memory.

Two in two processes and in one; one, and a node that only sends its input on.
"""

from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from bench.timing import cpu_seconds, megabytes
from flexx2_sim_ros.cli.ros import nodes
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
    print('one camera, and then an echo of the same messages')
    alone = _run([['left']], seconds)
    echo = _run_echo('left', seconds)
    print(
        f'one camera: {_RATE * alone.cpu:.1%} of a core (wanted: 12 %), the echo '
        f'{_RATE * echo.cpu:.1%}; {two.memory / 2:.0f} MB each of two (wanted: 120 MB)'
    )


def _run(groups, seconds):
    # Each group of cameras in a process of its own.
    options = ['--ros-args', '-p', 'usecase:=Mode_5_60fps', '--log-level', 'warn']
    commands = {'_'.join(names): ['flexx2_camera', *names, *options] for names in groups}
    cameras = [name for names in groups for name in names]
    with tempfile.TemporaryDirectory() as folder, nodes(commands, Path(folder)) as processes:
        return _measure(list(processes.values()), cameras, seconds)


def _run_echo(name, seconds):
    process = subprocess.Popen([sys.executable, '-m', 'bench.nodes', name])
    try:
        return _measure([process], [name], seconds)
    finally:
        process.terminate()
        process.wait(10)


def _measure(processes, cameras, seconds):
    # ROS is imported where it is needed: other measurements run without it.
    from bench.node_traffic import Traffic
    import rclpy

    def used():
        return sum(cpu_seconds(process.pid) for process in processes)

    rclpy.init(args=[])
    try:
        traffic = Traffic(cameras, _RATE)
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


def _echo(name):
    # Sends the input of a camera on under the names of its output.
    import rclpy
    from sensor_msgs.msg import CameraInfo, Image

    rclpy.init(args=[])
    node = rclpy.create_node('flexx2_camera', namespace=name)
    for kind, source, target in (
        (Image, 'clean/depth_image', 'flexx2_camera/depth_image_0'),
        (CameraInfo, 'clean/camera_info', 'flexx2_camera/camera_info'),
    ):
        node.create_subscription(kind, source, node.create_publisher(kind, target, 10).publish, 10)
    with suppress(rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    _echo(sys.argv[1])

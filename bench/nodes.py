"""Two camera nodes fed at 60 Hz each: gaps, latency, CPU and memory."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from bench.scenes import room
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np

_CAMERAS = ('left', 'right')
_RATE = 60
_SECONDS = 20


def run() -> None:
    """Print what came through, and how fast."""
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
        _measure(processes)
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGTERM)
        for process in processes.values():
            process.wait(10)


def _measure(processes: dict[str, subprocess.Popen[bytes]]) -> None:
    from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
    from flexx2_sim_ros.nodes import messages
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import CameraInfo, Image

    rclpy.init(args=[])
    node = rclpy.create_node('bench')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    sent: dict[tuple[str, int], float] = {}
    stamps: dict[str, list[int]] = {name: [] for name in _CAMERAS}
    latencies: list[float] = []

    def receive(name: str, message: Any) -> None:
        stamp = stamp_nanoseconds(message.header.stamp)
        latencies.append(time.perf_counter() - sent[name, stamp])
        stamps[name].append(stamp)

    topics = {}
    for name in _CAMERAS:
        topics[name] = (
            node.create_publisher(CameraInfo, f'/{name}/clean/camera_info', 10),
            node.create_publisher(Image, f'/{name}/clean/depth_image', 10),
        )
        node.create_subscription(
            Image,
            f'/{name}/flexx2_camera/depth_image_0',
            lambda message, name=name: receive(name, message),
            10,
        )

    def matched() -> bool:
        return all(
            publisher.get_subscription_count() for pair in topics.values() for publisher in pair
        ) and all(
            node.count_publishers(f'/{name}/flexx2_camera/depth_image_0') for name in _CAMERAS
        )

    deadline = time.monotonic() + 60
    while not matched() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    intrinsics, scene = flexx2().intrinsics, room()
    before = {name: cpu_seconds(process.pid) for name, process in processes.items()}
    own = time.process_time()
    start = time.perf_counter()
    frames = _RATE * _SECONDS
    for tick in range(1, frames + 1):
        while (left := start + tick / _RATE - time.perf_counter()) > 0:
            executor.spin_once(timeout_sec=left)
        stamp = tick * 10**9 // _RATE
        for name, (info, image) in topics.items():
            head = messages.header(stamp, 'camera')
            message = messages.image_message(head, scene, '32FC1')
            sent[name, stamp] = time.perf_counter()
            info.publish(messages.camera_info_message(head, intrinsics))
            image.publish(message)
    deadline = time.monotonic() + 2
    while len(latencies) < 2 * frames and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
    elapsed = time.perf_counter() - start

    latency = 1e3 * np.array(latencies)
    print(
        f'two cameras at Mode_5_60fps, fed at {_RATE} Hz each for {_SECONDS} s, '
        f'{len(os.sched_getaffinity(0))} cores'
    )
    for name, process in processes.items():
        gaps = int((np.diff(stamps[name]) > 1.5e9 / _RATE).sum())
        cpu = (cpu_seconds(process.pid) - before[name]) / elapsed
        print(
            f'{name:6s} {len(stamps[name])} of {frames} frames, {gaps} gaps, '
            f'{cpu:.0%} of a core, peak memory {resident_megabytes(process.pid):.0f} MB'
        )
    print(
        'latency from publishing to receiving, ms: '
        + ', '.join(
            f'{text} {np.percentile(latency, q):.2f}'
            for text, q in (('median', 50), ('p90', 90), ('p99', 99), ('max', 100))
        )
    )
    print(f'(this publisher and receiver: {(time.process_time() - own) / elapsed:.0%} of a core)')
    print('wanted: no gaps, p99 below 10 ms')
    node.destroy_node()
    rclpy.shutdown()


def cpu_seconds(pid: int) -> float:
    """Return the CPU time that a process has used."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def resident_megabytes(pid: int) -> float:
    """Return a process's largest resident memory so far."""
    for line in Path(f'/proc/{pid}/status').read_text().splitlines():
        if line.startswith('VmHWM'):
            return int(line.split()[1]) / 1024
    return float('nan')

"""Time from the start of a camera node's process to its first image, with a filled cache."""

import os
import statistics
import subprocess
import sys
import time
from typing import Any

from bench.nodes import cpu_seconds
from bench.plain_publisher import wall

_PERIOD = 1 / 30
_PATIENCE = 120.0
_WANTED = 3.0


def run(starts: int = 5) -> None:
    """Print the time of each start; a start before them fills the cache."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    import rclpy
    from sensor_msgs.msg import CameraInfo, Image

    rclpy.init(args=[])
    node = rclpy.create_node('bench_start')
    image, info = wall('224x172', 1.5)
    images = node.create_publisher(Image, 'clean/depth_image', 10)
    infos = node.create_publisher(CameraInfo, 'clean/camera_info', 10)
    heard: list[Any] = []
    command = [sys.executable, '-m', 'flexx2_sim_ros.nodes.flexx2_camera']
    command += ['--ros-args', '--log-level', 'warn']
    node.create_subscription(Image, 'flexx2_camera/depth_image_0', heard.append, 10)
    stamp = 0

    def start() -> tuple[float, float]:
        nonlocal stamp
        heard.clear()
        begun = time.monotonic()
        process = subprocess.Popen(command)
        try:
            while not heard and time.monotonic() < begun + _PATIENCE:
                stamp += round(_PERIOD * 1e9)
                for message in (info, image):
                    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
                infos.publish(info)
                images.publish(image)
                due = time.monotonic() + _PERIOD
                while not heard and (left := due - time.monotonic()) > 0:
                    rclpy.spin_once(node, timeout_sec=left)
            seconds = time.monotonic() - begun if heard else float('inf')
            return seconds, cpu_seconds(process.pid)
        finally:
            process.terminate()
            process.wait(_PATIENCE)

    start()
    seconds, computing = zip(*(start() for _ in range(starts)), strict=True)
    print(
        f'first image after {", ".join(f"{value:.2f}" for value in seconds)} s, median '
        f'{statistics.median(seconds):.2f} s (wanted: {_WANTED:g} s); the node computed for '
        f'{statistics.median(computing):.2f} s; load {os.getloadavg()[0]:.1f} on '
        f'{len(os.sched_getaffinity(0))} cores'
    )
    node.destroy_node()
    rclpy.shutdown()

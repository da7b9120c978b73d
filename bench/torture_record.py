"""
Kill recordings with kill -9 at random moments; measure how many seconds of them are lost.

``python -m bench.torture_record [KILLS [SEED]]``
"""

import os
from pathlib import Path
import random
import subprocess
import sys
import tempfile
import time

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processes import watched_environment
from flexx2_sim_ros.recording import open_recording

_STORAGES = ('mcap', 'sqlite3')
_CAMERAS = ('left', 'right')
_RATE = 60
_LONGEST = 4.0  # seconds from the first frame to the kill
_SHORTEST = 1.5
_PATIENCE = 60.0


def run(kills=20, seed=0):
    """
    Record two cameras at 60 Hz in each storage, kill, and print what is missing.

    * `kills`: number of kills for each storage
    * `seed`: seed of the moments

    Returns seconds between the last frame of a bag and the kill, by storage, for each camera.
    """
    import rclpy

    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    rng = random.Random(seed)
    rclpy.init(args=[])
    try:
        with tempfile.TemporaryDirectory() as folder:
            lost = {
                storage: [
                    seconds
                    for number in range(kills)
                    for seconds in _kill_one(
                        Path(folder) / f'{storage}{number}',
                        storage,
                        rng.uniform(_SHORTEST, _LONGEST),
                    )
                ]
                for storage in _STORAGES
            }
    finally:
        rclpy.try_shutdown()
    for storage, seconds in lost.items():
        ordered = sorted(seconds)
        print(
            f'{storage:8s} {kills} kills of a recording of {len(_CAMERAS)} cameras at {_RATE} Hz: '
            f'lost {ordered[len(ordered) // 2]:.2f} s (median), {ordered[-1]:.2f} s (most)'
        )
    print('wanted: at most 1 s')
    return lost


def _publisher(node, cameras):
    # Returns a function that publishes a frame of each camera, and returns the number of topics
    # that nobody subscribes to.
    from bench.plain_publisher import wall
    from sensor_msgs.msg import CameraInfo, Image

    image, info = wall('224x172', 1.5)
    image.data = random.Random(0).randbytes(224 * 172) * 4  # does not become small in a bag
    topics = [
        (node.create_publisher(kind, f'/{name}/{topic}', 10), message)
        for name in cameras
        for kind, topic, message in (
            (CameraInfo, 'clean/camera_info', info),
            (CameraInfo, 'flexx2_camera/camera_info', info),
            (Image, 'clean/depth_image', image),
            (Image, 'flexx2_camera/depth_image_0', image),
        )
    ]

    def publish():
        stamp = time.time_ns()
        for publisher, message in topics:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            publisher.publish(message)
        return sum(not publisher.get_subscription_count() for publisher, _ in topics)

    return publish


def _kill_one(bag, storage, seconds):
    import rclpy

    # Names of their own: a killed recorder stays on the graph for a while.
    cameras = [f'{bag.name}_{name}' for name in _CAMERAS]
    node = rclpy.create_node('torture_record')
    publish = _publisher(node, cameras)
    words = ['record', str(bag), '--storage', storage, '--cameras', *cameras]
    with subprocess.Popen(
        [sys.executable, '-m', 'flexx2_sim_ros.cli.main', *words],
        env=watched_environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    ) as process:
        end = time.monotonic() + _PATIENCE
        while publish() and process.poll() is None and time.monotonic() < end:
            time.sleep(1 / _RATE)
        begun = time.monotonic()
        for tick in range(round(seconds * _RATE)):
            time.sleep(max(0.0, begun + tick / _RATE - time.monotonic()))
            publish()
        process.kill()
        killed = time.time()
        if process.wait() != -9:
            raise RuntimeError(f'{bag}: the recorder ended by itself: exit {process.returncode}')
    node.destroy_node()
    return [_missing(bag, name, killed, seconds) for name in cameras]


def _missing(bag, camera, killed, seconds):
    try:
        return killed - float(open_recording(bag, camera).stamp[-1])
    except InputError as error:
        print(f'{bag.name}: {error}')
        return seconds


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))

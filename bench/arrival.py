"""How many images of another simulator reach a camera node, by size and quality of service."""

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from flexx2_sim_ros.nodes.transport import PROFILE_VARIABLES
from flexx2_sim_ros.paths import config_dir

_SIZES = ('224x172', '640x480', '1280x720', '1920x1080', '4096x3072')
_SECONDS = 2
_PUBLISHER = Path(__file__).with_name('plain_publisher.py')


def run() -> None:
    """Print how many of the sent images arrive."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    pinned = [
        '-p',
        'qos_overrides./best_effort/clean/depth_image.subscription.reliability:=best_effort',
    ]
    with _camera('follows') as follows, _camera('best_effort', *pinned) as best_effort:
        print(
            '| size | rate | publisher | its shared memory | arrived, the node as it is '
            '| arrived, best effort | slowest publish |'
        )
        print('|---|---|---|---|---|---|---|')
        for size in _SIZES:
            rate = 6 if size == '4096x3072' else 30
            for reliable in (True, False):
                for room in (False, True):
                    both = [
                        _measure(camera, size, rate, reliable, room)
                        for camera in ((follows, best_effort) if reliable else (follows,))
                    ]
                    sent, slowest = both[0][1:]
                    arrived = [f'{received} of {sent}' for received, *_ in both]
                    print(
                        f'| {size} | {rate} Hz | {"reliable" if reliable else "best effort"} | '
                        f'{"config/fastdds.xml" if room else "default"} | {arrived[0]} | '
                        f'{arrived[-1]} | {1e3 * slowest:.0f} ms |',
                        flush=True,
                    )


class _Camera:
    # Reads from its diagnostics how many images a camera node receives.

    def __init__(self, namespace: str) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.namespace = namespace
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self._node = rclpy.create_node(f'bench_{namespace}', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._reports: list[int] = []
        self._from = 0.0
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_report, 10)

    def _on_report(self, array: object) -> None:
        stamp = array.header.stamp  # type: ignore[attr-defined]
        if stamp.sec + 1e-9 * stamp.nanosec < self._from:
            return  # It was waiting here.
        for status in array.status:  # type: ignore[attr-defined]
            if status.name.startswith(f'{self.namespace}/'):
                self._reports.append(
                    int(
                        next(pair.value for pair in status.values if pair.key == 'inputs received')
                    )
                )

    def received(self) -> int:
        """Return the number of received images when two reports agree."""
        self._reports, self._from = [], time.time()
        deadline = time.monotonic() + 60
        while self._reports[-2:-1] != self._reports[-1:] or not self._reports:
            if time.monotonic() > deadline:
                raise RuntimeError(f'{self.namespace}: no diagnostics')
            self._executor.spin_once(timeout_sec=0.1)
        return self._reports[-1]

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.shutdown()


@contextmanager
def _camera(namespace: str, *parameters: str) -> Iterator[_Camera]:
    process = subprocess.Popen(
        [
            sys.executable,
            '-m',
            'flexx2_sim_ros.nodes.flexx2_camera',
            '--ros-args',
            '-r',
            f'__ns:=/{namespace}',
            '-p',
            'usecase:=Mode_5_60fps',
            '--log-level',
            'error',
            *parameters,
        ]
    )
    camera = _Camera(namespace)
    try:
        camera.received()
        yield camera
    finally:
        camera.close()
        process.send_signal(signal.SIGTERM)
        process.wait(10)


def _measure(
    camera: _Camera, size: str, rate: int, reliable: bool, room: bool
) -> tuple[int, int, float]:
    # Images received, images sent, seconds that the slowest publish call took.
    environment = {
        name: value for name, value in os.environ.items() if name not in PROFILE_VARIABLES
    }
    if room:
        environment[PROFILE_VARIABLES[0]] = str(config_dir() / 'fastdds.xml')
    before = camera.received()
    output = subprocess.run(
        [
            sys.executable,
            str(_PUBLISHER),
            f'/{camera.namespace}',
            '--size',
            size,
            '--rate',
            str(rate),
            '--count',
            str(_SECONDS * rate),
            *([] if reliable else ['--best-effort']),
        ],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    sent = json.loads(output.splitlines()[-1])
    return camera.received() - before, sent['sent'], sent['slowest']

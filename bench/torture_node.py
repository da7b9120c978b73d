"""
A camera node in a separate process that gets hostile messages and parameter calls.

``python -m bench.torture_node [MESSAGES [SEED]]``
"""

import os
from pathlib import Path
import random
import sys
import tempfile
import time

from bench.timing import megabytes
from flexx2_sim_ros.cli.ros import camera_command, nodes
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np

_NODE = 'torture/flexx2_camera'
# Pending requests; and seconds after which a node without an answer counts as frozen.
_WAITING = 8
_ANSWER_SECONDS = 60.0
# Number of memory samples; and number of those that are warm-up.
_PARTS, _WARM_UP = 10, 2
_ENCODINGS = ('32FC1', '64FC1', '16UC1', 'mono8', 'rgb8', '', 'x' * 300, '\x1b[31m', '32FC2')
_SIZES = (0, 1, 2, 7, 172, 224, 4096, 2**16, 2**31, 2**32 - 1)
_NUMBERS = (0.0, 1.0, -1.0, 1e-300, 1e300, float('nan'), float('inf'), -float('inf'), 111.5, 210.6)
_TEXTS = (
    '',
    'x',
    'typical',
    'typical*',
    '*',
    'nan',
    'zero',
    'radial',
    'Mode_9_5fps',
    'Mode_5_60fps',
    'x' * 300,
    'x' * 20_000,
    '\x1b[31m',
    '~',
    '/dev/zero',
    '/dev/tty',
    '.',
    '{date}',
    '{deep}',
    '{aliases}',
    '{pipe}',
)
_FILES = {
    'date': 'schema: 1\na: 2024-13-45',
    'deep': '[' * 3000,
    'aliases': 'a: &a [x, x]\nb: [*a, *a]',
}


def run(messages=100_000, seed=0):
    """
    Send a node hostile messages, every third one a parameter call, and a good image every 100.

    Returns ``sent`` messages, ``calls`` of parameter services among them and how many were
    ``answered``, ``received`` images, ``alive`` (whether the node still publishes), ``megabytes``
    at the start and after each tenth, ``growth_mb`` (after the first fifth), ``tracebacks`` in the
    node's log, and ``seconds``.
    """
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with nodes({'node': camera_command('torture')}, folder) as processes:
            result = _torture(processes['node'], folder, messages, random.Random(seed))
        log = (folder / 'node.log').read_text(errors='replace')
    result['tracebacks'] = log.count('Traceback')
    for name, value in result.items():
        print(f'{name:20s} {value}')
    return result


class _User:
    # Sends to the node and listens to it.

    def __init__(self, process):
        import rclpy
        from sensor_msgs.msg import CameraInfo, Image

        self._process, self._spin_once = process, rclpy.spin_once
        self.node = rclpy.create_node('torture')
        self.heard = []
        self.node.create_subscription(Image, f'/{_NODE}/depth_image_0', self.heard.append, 10)
        self.topics = {
            name: self.node.create_publisher(kind, f'/torture/clean/{name}', 10)
            for name, kind in (
                ('depth_image', Image),
                ('camera_info', CameraInfo),
                ('reflectivity', Image),
            )
        }
        self.clients = _clients(self.node)
        self.waiting = []
        self.calls = self.answered = self.received = 0

    def ready(self):
        return self.spin_until(
            lambda: (
                self.node.count_publishers(f'/{_NODE}/depth_image_0')
                and all(publisher.get_subscription_count() for publisher in self.topics.values())
                and all(client.service_is_ready() for client, _ in self.clients)
            )
        )

    def spin_until(self, condition):
        deadline = time.monotonic() + _ANSWER_SECONDS
        while not condition() and time.monotonic() < deadline and self._process.poll() is None:
            self._spin_once(self.node, timeout_sec=0.02)
        return bool(condition())

    def show(self, stamp):
        from flexx2_sim_ros.nodes import messages

        head = messages.header(stamp, 'camera')
        wall = np.full((172, 224), 1.5, np.float32)
        self.topics['camera_info'].publish(messages.camera_info_message(head, flexx2().intrinsics))
        self.topics['depth_image'].publish(messages.image_message(head, wall, '32FC1'))

    def send(self, count, rng, folder):
        if count % 3 == 0:
            client, make = self.clients[self.calls % len(self.clients)]
            self.waiting.append(client.call_async(make(rng, folder)))
            self.calls += 1
        elif count % 100 == 1:
            self.show(count * 10**9)
        else:
            name = rng.choice(list(self.topics))
            self.topics[name].publish(_info(rng) if name == 'camera_info' else _image(rng))
        self._spin_once(self.node, timeout_sec=0)
        self.received += len(self.heard)
        self.heard.clear()

    def all_answered(self, left):
        # Waits until at most this many requests are pending.
        self.spin_until(lambda: sum(not future.done() for future in self.waiting) <= left)
        self.answered += sum(future.done() for future in self.waiting)
        self.waiting = [future for future in self.waiting if not future.done()]
        return len(self.waiting) <= left

    def still_publishes(self):
        self.heard.clear()
        # Stamps that were not used before.
        stamps = iter(range(2 * 10**18, 3 * 10**18, 10**9))

        def came():
            self.show(next(stamps))
            return any(message.header.stamp.sec >= 2 * 10**9 for message in self.heard)

        return self.spin_until(came)


def _torture(process, folder, messages, rng):
    import rclpy

    for name, text in _FILES.items():
        (folder / name).write_text(text)
    os.mkfifo(folder / 'pipe')
    rclpy.init(args=[])
    user = _User(process)
    try:
        start, sent, used = time.monotonic(), 0, [megabytes(process.pid)]
        answers = any(user.ready() for _ in range(3))  # Starting takes long on a busy machine.
        while answers and sent < messages:
            user.send(sent, rng, str(folder))
            sent += 1
            answers = user.all_answered(_WAITING)
            if sent >= len(used) * messages / _PARTS:
                used.append(megabytes(process.pid))
        user.all_answered(0)
        grown = used[-1] - used[min(_WARM_UP, len(used) - 1)]
        return {
            'sent': sent,
            'calls': user.calls,
            'answered': user.answered,
            'received': user.received,
            'alive': user.still_publishes(),
            'megabytes': [round(value, 1) for value in used],
            'growth_mb': round(grown, 1),
            'seconds': round(time.monotonic() - start, 1),
        }
    finally:
        user.node.destroy_node()
        rclpy.try_shutdown()


def _clients(node):
    from rcl_interfaces import srv

    def values(kind):
        return lambda rng, folder: kind.Request(
            parameters=[_parameter(rng, folder) for _ in range(rng.randrange(4))]
        )

    def names(kind):
        return lambda rng, folder: kind.Request(
            names=[_name(rng) for _ in range(rng.choice((0, 1, 3, 2000)))]
        )

    def listed(rng, folder):
        return srv.ListParameters.Request(
            prefixes=[_name(rng) for _ in range(rng.randrange(3))],
            depth=rng.choice((0, 1, 2, 2**63, 2**64 - 1)),
        )

    made = [
        ('set_parameters', srv.SetParameters, values(srv.SetParameters)),
        (
            'set_parameters_atomically',
            srv.SetParametersAtomically,
            values(srv.SetParametersAtomically),
        ),
        ('get_parameters', srv.GetParameters, names(srv.GetParameters)),
        ('get_parameter_types', srv.GetParameterTypes, names(srv.GetParameterTypes)),
        ('describe_parameters', srv.DescribeParameters, names(srv.DescribeParameters)),
        ('list_parameters', srv.ListParameters, listed),
    ]
    return [(node.create_client(kind, f'/{_NODE}/{name}'), make) for name, kind, make in made]


def _name(rng):
    effect = f'effect.{rng.choice(list(registry()))}.strength'
    return rng.choice(
        (
            'usecase',
            'effects',
            'auto_exposure_0',
            'exposure_time_0',
            'frame_id',
            'invalid_value',
            'input_depth',
            'use_sim_time',
            'serial',
            'seed',
            effect,
            '',
            '.',
            'usecas',
            '\x1b[31m',
            'x' * 5000,
        )
    )


def _parameter(rng, folder):
    from rcl_interfaces.msg import Parameter, ParameterValue

    text = rng.choice(_TEXTS)
    if text.startswith('{'):
        text = f'{folder}/{text[1:-1]}'
    return Parameter(
        name=_name(rng),
        value=ParameterValue(
            type=rng.choice((*range(11), 255, 1, 2, 3, 4, 4, 4)),
            bool_value=rng.random() < 0.5,
            integer_value=rng.choice((0, 1, 90, 370, -1, 2**63 - 1, -(2**63))),
            double_value=rng.choice(_NUMBERS),
            string_value=text,
            double_array_value=[rng.choice(_NUMBERS)] * rng.randrange(3),
            string_array_value=[text] * rng.randrange(3),
            byte_array_value=[b'\xff'] * rng.randrange(3),
        ),
    )


def _header(rng, message):
    message.header.stamp.sec = rng.choice((-(2**31), -1, 0, rng.randrange(10**6), 2**31 - 1))
    message.header.stamp.nanosec = rng.choice((0, 1, 10**9 - 1, 10**9, 2**32 - 1))
    message.header.frame_id = rng.choice(('camera', '', '\x1b[31m', 'x' * 3000))
    return message


def _image(rng):
    from sensor_msgs.msg import Image

    width, height = (224, 172) if rng.random() < 0.3 else (rng.choice(_SIZES), rng.choice(_SIZES))
    fits = (width * 4 * height) if (width, height) == (224, 172) else rng.choice((0, 1, 999))
    message = Image(
        width=width,
        height=height,
        encoding=rng.choice(_ENCODINGS),
        step=rng.choice((width * 4 % 2**32, *_SIZES)),
        is_bigendian=rng.choice((0, 1, 255)),
    )
    message.data.frombytes(rng.randbytes(fits) if rng.random() < 0.2 else bytes(fits))
    return _header(rng, message)


def _info(rng):
    from sensor_msgs.msg import CameraInfo

    message = CameraInfo(
        width=rng.choice(_SIZES),
        height=rng.choice(_SIZES),
        distortion_model=rng.choice(('plumb_bob', '', 'equidistant', 'x' * 3000)),
        d=[rng.choice(_NUMBERS)] * rng.choice((0, 5, 8, 2000)),
        k=[rng.choice(_NUMBERS) for _ in range(9)],
    )
    return _header(rng, message)


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))

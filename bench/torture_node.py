"""
A camera node in a separate process that gets hostile messages and parameter calls.

``python -m bench.torture_node [MESSAGES [SEED]]``
"""

from contextlib import chdir
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
_SIZES = (0, 1, 2, 7, 172, 224, 4096, 2**16, 2**31, 2**32 - 1)
_NUMBERS = (0.0, 1.0, -1.0, 1e-300, 1e300, float('nan'), float('inf'), -float('inf'), 111.5, 210.6)
_ODD = ('', 'x', '.', '\x1b[31m', 'x' * 300, 'x' * 5000)
# Files are in the folder in which the node runs.
_FILES = {
    'date': 'schema: 1\na: 2024-13-45',
    'deep': '[' * 3000,
    'aliases': 'a: &a [x, x]\nb: [*a, *a]',
}
_TEXTS = (
    *(*_ODD, 'x' * 20_000, 'typical', 'typical*', '*', 'nan', 'zero', 'radial', 'Mode_9_5fps'),
    *('Mode_5_60fps', '~', '/dev/zero', '/dev/tty', *_FILES, 'pipe'),
)
_NAMES = (
    *(*_ODD, 'usecase', 'effects', 'auto_exposure_0', 'exposure_time_0', 'frame_id', 'usecas'),
    *('invalid_value', 'input_depth', 'use_sim_time', 'serial', 'seed'),
)


def _name(rng):
    effect = f'effect.{rng.choice(list(registry()))}.strength'
    return rng.choice((*_NAMES, effect))


def _parameters(rng):
    from rcl_interfaces.msg import Parameter

    return [_filled(Parameter(), rng) for _ in range(rng.randrange(4))]


def _several(choices, *counts):
    return lambda rng: [rng.choice(choices)] * rng.choice(counts)


# What the fields of messages and requests get, by name: one of these, or what a function returns.
_FIELDS = {
    'sec': (-(2**31), -1, 0, 1000, 2**31 - 1),
    'nanosec': (0, 1, 10**9 - 1, 10**9, 2**32 - 1),
    'frame_id': ('camera', *_ODD),
    'width': _SIZES,
    'height': _SIZES,
    'step': _SIZES,
    'encoding': ('32FC1', '64FC1', '16UC1', 'mono8', 'rgb8', '32FC2', *_ODD),
    'is_bigendian': (0, 1, 255),
    'distortion_model': ('plumb_bob', 'equidistant', *_ODD),
    'd': _several(_NUMBERS, 0, 5, 8, 2000),
    'k': lambda rng: rng.choices(_NUMBERS, k=9),
    'name': _name,
    'type': (*range(11), 255, 1, 2, 3, 4, 4, 4),
    'bool_value': (False, True),
    'integer_value': (0, 1, 90, 370, -1, 2**63 - 1, -(2**63)),
    'double_value': _NUMBERS,
    'string_value': _TEXTS,
    'double_array_value': _several(_NUMBERS, 0, 1, 2),
    'string_array_value': _several(_TEXTS, 0, 1, 2),
    'byte_array_value': _several((b'\xff',), 0, 1, 2),
    'parameters': _parameters,
    'names': lambda rng: [_name(rng) for _ in range(rng.choice((0, 1, 3, 2000)))],
    'prefixes': lambda rng: [_name(rng) for _ in range(rng.randrange(3))],
    'depth': (0, 1, 2, 2**63, 2**64 - 1),
}


def _filled(message, rng):
    # The message, its fields and those of messages inside filled.
    for name in message.get_fields_and_field_types():
        inside = getattr(message, name)
        if name in _FIELDS:
            values = _FIELDS[name]
            setattr(message, name, values(rng) if callable(values) else rng.choice(values))
        elif hasattr(inside, 'get_fields_and_field_types'):
            _filled(inside, rng)
    return message


def _image(rng):
    from sensor_msgs.msg import Image

    message, size = _filled(Image(), rng), rng.choice((0, 1, 999))
    if rng.random() < 0.3:
        message.width, message.height, size = 224, 172, 4 * 224 * 172
    if rng.random() < 0.3:
        message.step = 4 * message.width % 2**32
    message.data.frombytes(rng.randbytes(size) if rng.random() < 0.2 else bytes(size))
    return message


def run(messages=100_000, seed=0):
    """
    Send a node hostile messages, every third one a parameter call, and a good image every 100.

    Returns ``sent`` messages, ``calls`` of parameter services among them and how many were
    ``answered``, ``received`` images, ``alive`` (whether the node still publishes), ``megabytes``
    at the start and after each tenth, ``growth_mb`` (after the first fifth), ``tracebacks`` in the
    node's log, and ``seconds``.
    """
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for name, text in _FILES.items():
            Path(name).write_text(text)
        os.mkfifo('pipe')
        with nodes({'node': camera_command('torture')}, Path()) as processes:
            result = _torture(processes['node'], messages, random.Random(seed))
        log = Path('node.log').read_text(errors='replace')
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

    def send(self, count, rng):
        from sensor_msgs.msg import CameraInfo

        if count % 3 == 0:
            client, request = self.clients[self.calls % len(self.clients)]
            self.waiting.append(client.call_async(_filled(request(), rng)))
            self.calls += 1
        elif count % 100 == 1:
            self.show(count * 10**9)
        else:
            name = rng.choice(list(self.topics))
            info = name == 'camera_info'
            self.topics[name].publish(_filled(CameraInfo(), rng) if info else _image(rng))
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


def _torture(process, messages, rng):
    import rclpy

    rclpy.init(args=[])
    user = _User(process)
    try:
        start, sent, used = time.monotonic(), 0, [megabytes(process.pid)]
        answers = any(user.ready() for _ in range(3))  # Starting takes long on a busy machine.
        while answers and sent < messages:
            user.send(sent, rng)
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
    # Of each service of the node's parameters, and the kind of its requests.
    from rcl_interfaces import srv

    kinds = {
        'set_parameters': srv.SetParameters,
        'set_parameters_atomically': srv.SetParametersAtomically,
        'get_parameters': srv.GetParameters,
        'get_parameter_types': srv.GetParameterTypes,
        'describe_parameters': srv.DescribeParameters,
        'list_parameters': srv.ListParameters,
    }
    return [
        (node.create_client(kind, f'/{_NODE}/{name}'), kind.Request)
        for name, kind in kinds.items()
    ]


if __name__ == '__main__':
    run(*map(int, sys.argv[1:]))

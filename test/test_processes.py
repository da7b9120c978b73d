"""The nodes as the processes they are: how they start, what they publish, how they end."""

import itertools
import signal
import subprocess

from bench.torture_kill import handles_signals
from flexx2_sim_ros.camera import Camera
import numpy as np
from programs import node_words, PATIENCE, until
import pytest
from streams import (
    array_of,
    CameraInfo,
    Clock,
    DEPTH,
    FLEXX2,
    Image,
    image_message,
    info_message,
    listening,
    nanoseconds,
)

SECOND = 1_000_000_000
CAMERA, GO1 = 'flexx2_camera', 'go1_cameras'
WALL = np.full((172, 224), 1.5, np.float32)

_numbers = itertools.count()


class Node:
    """
    A node running as a process, with what it wrote to stderr.

    `namespace`: one of its own.
    """

    def __init__(self, executable, folder, env, *parameters, arguments=()):
        """Start it."""
        self.namespace = f'/process_{next(_numbers)}'
        self._log = folder / f'{executable}{self.namespace.replace("/", "_")}.log'
        command = node_words(executable, '-r', f'__ns:={self.namespace}', *arguments)
        for parameter in parameters:
            command += ['-p', parameter]
        with self._log.open('wb') as log:
            self.process = subprocess.Popen(
                command, env=env, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
            )

    @property
    def output(self):
        """Return what it has written so far."""
        return self._log.read_text(errors='replace')

    def wait(self):
        """Return the exit code."""
        return self.process.wait(PATIENCE)

    def assert_ends_quietly(self, number):
        """Send a signal and assert the process ends at once, with exit code 0, without a fuss."""
        assert self.process.poll() is None, self.output
        self.process.send_signal(number)
        assert self.wait() == 0, self.output
        for word in ('Traceback', 'Error', 'ERROR', 'Exception', 'error:'):
            assert word not in self.output, self.output


@pytest.fixture
def start(tmp_path, child_env):
    """Return a function that starts a node; those that still run are killed at the end."""
    nodes = []

    def started(executable, *parameters, arguments=()):
        nodes.append(Node(executable, tmp_path, child_env, *parameters, arguments=arguments))
        return nodes[-1]

    yield started
    for node in nodes:
        if node.process.poll() is None:
            node.process.kill()
            node.process.wait()


@pytest.mark.parametrize(
    ('executable', 'number'), [(CAMERA, signal.SIGINT), (GO1, signal.SIGTERM)]
)
def test_a_signal_while_starting_ends_the_process(start, executable, number):
    node = start(executable)
    until(lambda: handles_signals(node.process.pid, [signal.SIGTERM]))
    node.assert_ends_quietly(number)
    assert node.output == ''


def test_the_camera_node(start):
    node = start(
        CAMERA,
        'usecase:=mode_5_60fps',
        'seed:=9',
        'camera_name:=left',
        'serial:=0042',
        'invalid_value:=nan',
        'cx:=111.5',
    )
    with listening() as user:
        image, info = (
            user.node.create_publisher(kind, f'{node.namespace}/clean/{topic}', 10)
            for kind, topic in ((Image, 'depth_image'), (CameraInfo, 'camera_info'))
        )
        topic = f'{node.namespace}/{CAMERA}/{DEPTH}'
        seen = user.listen(topic, Image)
        user.spin_until(lambda: image.get_subscription_count() and info.get_subscription_count())
        stamps = itertools.count(SECOND, SECOND // 60)
        # Both ends know each other at different times: the first images may get lost.
        for stamp in itertools.islice(stamps, 2000):
            info.publish(info_message(FLEXX2, stamp))
            image.publish(image_message(WALL, stamp))
            user.spin_for_a_message()
            if len(seen) >= 3:
                break
        assert len(seen) >= 3
        camera = Camera('Mode_5_60fps', seed=9, name='left')
        for message in seen:
            expected = camera.capture(WALL, FLEXX2.matrix, nanoseconds(message)).depth
            np.testing.assert_array_equal(array_of(message), expected)
        for stamp in itertools.islice(stamps, 8):
            info.publish(info_message(FLEXX2, stamp))
            image.publish(image_message(WALL, stamp))
        node.assert_ends_quietly(signal.SIGTERM)
        # It took leave: nobody goes on computing for it, or waiting for it.
        user.spin_until(lambda: not image.get_subscription_count())
        user.spin_until(lambda: not user.node.count_publishers(topic))


def _common_stamps(heard, clock):
    ticks = {message.clock.sec * SECOND + message.clock.nanosec for message in clock}
    return ticks.intersection(
        *({nanoseconds(message) for message in messages} for messages in heard)
    )


def test_the_robot_node(start):
    node, rate = start(GO1), 60
    cameras = ('front_left', 'front_right')
    with listening() as user:
        heard = {
            (camera, topic): user.listen(f'{node.namespace}/{camera}/clean/{topic}', kind)
            for camera in cameras
            for topic, kind in (
                ('depth_image', Image),
                ('camera_info', CameraInfo),
                ('reflectivity', Image),
            )
        }
        clock = user.listen('/clock', Clock)
        user.spin_until(
            lambda: len(_common_stamps(heard.values(), clock)) >= 8,
            'messages of one stamp on every topic',
        )
        node.assert_ends_quietly(signal.SIGINT)
        assert 'rendered by' in node.output

    by_stamp = {
        key: {nanoseconds(message): message for message in messages}
        for key, messages in heard.items()
    }
    for stamps in ([m.clock.sec * SECOND + m.clock.nanosec for m in clock], *by_stamp.values()):
        ticks = [round(stamp * rate / SECOND) for stamp in stamps]
        assert list(stamps) == [tick * SECOND // rate for tick in ticks]
        assert ticks == sorted(set(ticks))
    common = _common_stamps(heard.values(), clock)
    for camera in cameras:
        for stamp in common:
            depth, info, paint = (
                by_stamp[camera, topic][stamp]
                for topic in ('depth_image', 'camera_info', 'reflectivity')
            )
            assert depth.header == info.header == paint.header
            assert depth.header.frame_id == f'{camera}_optical_frame'
            assert (depth.encoding, depth.width, depth.height) == ('32FC1', 224, 172)
            assert (paint.encoding, paint.width, paint.height) == ('32FC1', 224, 172)
            assert (info.width, info.height) == (224, 172)
            assert list(info.k) == [FLEXX2.fx, 0, 111.5, 0, FLEXX2.fy, 85.5, 0, 0, 1]
        pixels, albedo = array_of(depth), array_of(paint)
        valid = np.isfinite(pixels)
        assert valid.any()
        assert np.isnan(pixels[~valid]).all()
        assert (pixels[valid] > 0.02).all()
        assert (pixels[valid] < 20).all()
        assert ((albedo >= 0) & (albedo <= 1)).all()


BROKEN = '<mujoco><worldbody><body name="trunk"><geom size="-1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ('executable', 'options', 'parts'),
    [
        (CAMERA, ['usecase:=Mode_9_31fps'], ['usecase', 'Mode_9_31fps', 'Mode_9_30fps']),
        (CAMERA, ['usecase'], ['usecase']),
        (GO1, ['robot_model:=/nowhere/robot.xml'], ['robot', '/nowhere/robot.xml', 'must be']),
    ],
    ids=str,
)
def test_bad_parameters_at_start(start, tmp_path, executable, options, parts):
    (tmp_path / 'broken.xml').write_text(BROKEN)
    node = start(executable, *(option.format(folder=tmp_path) for option in options))
    assert node.wait() == 1, node.output
    assert 'Traceback' not in node.output
    errors = [line for line in node.output.splitlines() if line.startswith('error: ')]
    assert len(errors) == 1, node.output
    assert all(part in errors[0] for part in parts), errors[0]


def test_a_parameter_file_that_is_not_there(start):
    node = start(CAMERA, arguments=('--params-file', '/nowhere/parameters.yaml'))
    assert node.wait() == 1
    assert 'Traceback' not in node.output
    assert '/nowhere/parameters.yaml' in node.output

"""The nodes as the processes they are: how they start, what they publish, how they end."""

import itertools
import signal
import subprocess

from bench.torture_kill import handles_signals
from flexx2_sim_ros.camera import Camera
import numpy as np
from programs import finish, node_words, starting, until
import pytest
from streams import (
    array_of,
    CameraInfo,
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


@pytest.fixture
def start(child_env):
    """Return a function that runs a node, whose log is its output; it is over at the end."""
    with starting(env=child_env, stderr=subprocess.STDOUT) as run:
        yield lambda executable, *words: run(node_words(executable, *words))


def ended_quietly(process, number):
    """Send a signal and return what the node wrote; it ends with exit code 0, without a fuss."""
    assert process.poll() is None
    output = finish(process, number)
    for word in ('Error', 'ERROR', 'Exception', 'error:'):
        assert word not in output, output
    return output


@pytest.mark.parametrize(
    ('executable', 'number'), [(CAMERA, signal.SIGINT), (GO1, signal.SIGTERM)]
)
def test_a_signal_while_starting_ends_the_process(start, executable, number):
    node = start(executable)
    until(lambda: handles_signals(node.pid, [signal.SIGTERM]))
    assert ended_quietly(node, number) == ''


def test_the_camera_node(start):
    parameters = 'usecase:=mode_5_60fps', 'seed:=9', 'camera_name:=left', 'cx:=111.5'
    words = [word for parameter in parameters for word in ('-p', parameter)]
    node = start(CAMERA, '-r', '__ns:=/process', *words)
    with listening() as user:
        image, info = (
            user.node.create_publisher(kind, f'/process/clean/{topic}', 10)
            for kind, topic in ((Image, 'depth_image'), (CameraInfo, 'camera_info'))
        )
        topic = f'/process/{CAMERA}/{DEPTH}'
        seen = user.listen(topic, Image)
        user.spin_until(lambda: image.get_subscription_count() and info.get_subscription_count())
        stamps = itertools.count(SECOND, SECOND // 60)

        def feed():
            # Both ends know each other at different times: the first images may get lost.
            stamp = next(stamps)
            info.publish(info_message(FLEXX2, stamp))
            image.publish(image_message(WALL, stamp))
            return len(seen) >= 3

        user.spin_until(feed, 'three images')
        camera = Camera('Mode_5_60fps', seed=9, name='left')
        for message in seen:
            expected = camera.capture(WALL, FLEXX2.matrix, nanoseconds(message)).depth
            np.testing.assert_array_equal(array_of(message), expected)
        for _ in range(8):  # It ends although there is more to do.
            feed()
        ended_quietly(node, signal.SIGTERM)
        # It took leave: nobody goes on computing for it, or waiting for it.
        user.spin_until(lambda: not image.get_subscription_count())
        user.spin_until(lambda: not user.node.count_publishers(topic))


def test_the_robot_node(start):
    node = start(GO1, '-r', '__ns:=/process')
    cameras = 'front_left', 'front_right'
    kinds = {'depth_image': Image, 'camera_info': CameraInfo, 'reflectivity': Image}
    with listening() as user:
        heard = {
            (camera, topic): user.listen(f'/process/{camera}/clean/{topic}', kind)
            for camera in cameras
            for topic, kind in kinds.items()
        }

        def common():
            stamps = [{nanoseconds(message) for message in some} for some in heard.values()]
            return set.intersection(*stamps)

        user.spin_until(common, 'messages of one stamp on every topic')
        stamp = max(common())
        assert 'rendered by' in ended_quietly(node, signal.SIGINT)
    for camera in cameras:
        depth, info, paint = (
            next(one for one in heard[camera, topic] if nanoseconds(one) == stamp)
            for topic in kinds
        )
        assert depth.header == info.header == paint.header
        assert depth.header.frame_id == f'{camera}_optical_frame'
        assert list(info.k) == [FLEXX2.fx, 0, 111.5, 0, FLEXX2.fy, 85.5, 0, 0, 1]
        pixels, albedo = array_of(depth), array_of(paint)
        assert pixels.shape == albedo.shape == (info.height, info.width) == (172, 224)
        valid = np.isfinite(pixels)
        assert valid.any()
        assert 0.02 < pixels[valid].min() < pixels[valid].max() < 20
        assert ((albedo >= 0) & (albedo <= 1)).all()


@pytest.mark.parametrize(
    ('executable', 'words', 'parts'),
    [
        (CAMERA, ['-p', 'usecase:=Mode_9_31fps'], ['usecase', 'Mode_9_31fps', 'Mode_9_30fps']),
        (GO1, ['-p', 'robot_model:=/nowhere/r.xml'], ['robot', '/nowhere/r.xml', 'must be']),
        (CAMERA, ['--params-file', '/nowhere/parameters.yaml'], ['/nowhere/parameters.yaml']),
    ],
    ids=['mode', 'robot', 'no file'],
)
def test_what_is_wrong_at_the_start_is_said_in_one_line(start, executable, words, parts):
    said = finish(start(executable, *words), code=1)
    (error,) = (line for line in said.splitlines() if line.startswith('error: '))
    assert all(part in error for part in parts), error

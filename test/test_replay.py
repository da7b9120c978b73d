"""`flexx2 replay` as a process, over real DDS."""

import signal

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes.player import Player
from flexx2_sim_ros.nodes.ros_graph import message_class
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_writer import BagWriter
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from recorders import finish, flexx2, PATIENCE, SECOND, STEP, whole
import streams
from streams import Clock, DEPTH, GRAY, image_message, INFO, info_message

pytestmark = pytest.mark.usefixtures('ros')


def write(bag, messages):
    """Write (topic, time received, message) to a bag."""
    with BagWriter(bag) as writer:
        for topic, received, message in messages:
            kind = f'sensor_msgs/msg/{type(message).__name__}'
            writer.write(topic, kind, received, bytes(serialize_message(message)))
    return bag


def replayed(child_env, bag, *options):
    """Replay a bag; return the messages heard by topic, the clock's, and what was said."""
    whole = Bag(bag)
    count = len(list(whole.messages(None)))
    with (
        flexx2(child_env, 'replay', bag, '--wait', PATIENCE, *options) as process,
        streams.listening() as listener,
    ):
        clock = listener.listen('/clock', Clock)
        heard = {
            topic: listener.listen(topic, message_class(kind))
            for topic, kind in whole.topics.items()
        }
        listener.spin_until(lambda: sum(map(len, heard.values())) == count, 'the whole bag')
        return heard, clock, finish(process)


def test_replay_gives_the_same_messages_and_their_time(child_env, tmp_path):
    stamps = [SECOND + index * STEP for index in range(30)]
    rng = np.random.default_rng(1)
    messages = []
    for stamp in stamps:
        for camera in ('left', 'right'):
            space = f'/replayed/{camera}'
            pixels = rng.uniform(0.1, 7.0, (172, 224)).astype('f4')
            messages += [
                (f'{space}/clean/camera_info', stamp, info_message(streams.FLEXX2, stamp)),
                (f'{space}/clean/depth_image', stamp, image_message(pixels, stamp)),
            ]
    bag = write(tmp_path / 'bag', messages)
    heard, clock, said = replayed(child_env, bag, '--rate', 5)
    assert '120 messages' in said
    for topic, found in heard.items():
        sent = [message for other, _, message in messages if other == topic]
        assert found == sent, 'every byte, in its order'
    assert [message.clock.sec * SECOND + message.clock.nanosec for message in clock] == stamps


def test_recorded_clean_depth_gives_the_recorded_camera(child_env, tmp_path):
    bag = tmp_path / 'bag'
    rng = np.random.default_rng(3)
    scene = np.full((172, 224), 1.2, np.float32)
    scene[40:90, 60:150] = 0.7
    with streams.stream(DEPTH, usecase='Mode_5_60fps') as camera:
        space = camera.name.rpartition('/')[0]
        topics = [f'{camera.name}/{topic}' for topic in (DEPTH, INFO, GRAY)]
        topics += [f'{space}/clean/{topic}' for topic in ('depth_image', INFO, 'reflectivity')]
        publishers = {
            publisher: publisher.get_subscription_count()
            for publisher in (*camera.camera.publishers, *camera.node.publishers)
            if publisher.topic_name in topics
        }
        assert len(publishers) == len(topics)
        with flexx2(child_env, 'record', bag, '--cameras', space) as process:
            # Others listen to some of them already.
            camera.spin_until(
                lambda: all(one.get_subscription_count() > n for one, n in publishers.items()),
                'the recorder',
            )
            for index in range(12):
                shown = scene + rng.uniform(0, 0.01, scene.shape).astype('f4')
                assert camera.show(shown, SECOND + index * STEP, scene / 4)
            # The mode is asked for when the camera's services are seen.
            camera.spin_until(lambda: whole(bag, 12), 'frames and mode on the disk')
            text = finish(process, signal.SIGINT)
        recorded = load_recording(bag)
        assert '0 messages lost' in text
        assert recorded.usecase == 'Mode_5_60fps'
        assert len(recorded.depth) == 12
        assert recorded.amplitude.any()
        for seen, frame in zip(camera.depths(), recorded.depth, strict=True):
            np.testing.assert_array_equal(seen, frame)

        camera.messages(DEPTH).clear()
        slowly = '--wait', PATIENCE, '--rate', 0.2, '--no-clock'
        with flexx2(child_env, 'replay', bag, '--topics', '*/clean/*', *slowly) as process:
            camera.spin_until(lambda: len(camera.messages(DEPTH)) == 12, 'the camera again')
            finish(process)
        for seen, frame in zip(camera.depths(), recorded.depth, strict=True):
            np.testing.assert_array_equal(seen, frame)


def test_a_stamp_of_another_clock_does_not_stop_replay(child_env, tmp_path):
    """Assert it for a camera info that was sent once, and for an image before a clock ran."""
    start = 1_700_000_000 * SECOND
    images = start, start + STEP, start + 2 * STEP
    wall = np.ones((43, 56), np.float32)
    messages = []
    for name, info_stamp, first in (('info', 0, start), ('image', start, 0)):
        topic, info = f'/odd_{name}/clean/camera_info', info_message(streams.FLEXX2, info_stamp)
        messages.append((topic, start, info))
        for received, stamp in zip(images, (first, *images[1:]), strict=True):
            topic = f'/odd_{name}/clean/depth_image'
            messages.append((topic, received, image_message(wall, stamp)))
    bag = write(tmp_path / 'bag', sorted(messages, key=lambda one: one[1]))
    heard, _, _ = replayed(child_env, bag)
    assert sorted(len(found) for found in heard.values()) == [1, 1, 3, 3]


def test_replay_without_a_topic(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/a', 'sensor_msgs/msg/Image', 0, b'\x00\x01\x00\x00' + bytes(40))
    with pytest.raises(InputError, match='topics: must match .*/a.*, got none'):
        Player(Bag(tmp_path / 'bag'), ['/b'], True)

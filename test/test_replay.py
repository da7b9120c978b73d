"""`flexx2 replay` as a process, over real DDS."""

import os
import signal

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_writer import BagWriter
import numpy as np
import pytest
from recorders import finish, flexx2, open_source, PATIENCE, SECOND, STEP, whole
import streams
from streams import CameraInfo, Clock, DEPTH, Image, image_message, info_message

pytestmark = pytest.mark.usefixtures('ros')


@pytest.fixture
def source():
    with open_source() as found:
        yield found


def test_replay_gives_the_same_messages_and_their_time(source, child_env, tmp_path):
    bag = tmp_path / 'bag'
    with flexx2(child_env, 'record', bag, '--cameras', *source.cameras) as process:
        source.wait()
        source.publish(30)
        source.settle()
        finish(process, signal.SIGINT)
    listener = source.listener
    for publisher in source.publishers.values():
        listener.node.destroy_publisher(publisher)

    with flexx2(child_env, 'replay', bag, '--wait', PATIENCE, '--rate', 5) as process:
        clock = listener.listen('/clock', Clock)
        heard = {
            topic: listener.listen(topic, publisher.msg_type)
            for topic, publisher in source.publishers.items()
        }
        listener.spin_until(
            lambda: all(len(messages) == 30 for messages in heard.values()), 'the whole bag'
        )
        text = finish(process)
    for topic, messages in heard.items():
        assert messages == source.sent[topic], 'every byte, in its order'
    stamps = [SECOND + index * STEP for index in range(30)]
    assert [message.clock.sec * SECOND + message.clock.nanosec for message in clock] == stamps
    assert f'{30 * len(heard)} messages' in text


def test_recorded_clean_depth_gives_the_recorded_camera(child_env, tmp_path):
    bag = tmp_path / 'bag'
    rng = np.random.default_rng(3)
    scene = np.full((172, 224), 1.2, np.float32)
    scene[40:90, 60:150] = 0.7
    with streams.stream(DEPTH, usecase='Mode_5_60fps') as camera:
        space = camera.name.rpartition('/')[0]
        with flexx2(child_env, 'record', bag, '--cameras', space) as process:
            publishers = [*camera.camera.publishers, *camera.node.publishers]
            wanted = {
                f'{camera.name}/{DEPTH}',
                f'{camera.name}/camera_info',
                f'{camera.name}/gray_image_0',
                *(
                    f'{space}/clean/{name}'
                    for name in ('depth_image', 'camera_info', 'reflectivity')
                ),
            }
            listeners = {
                publisher.topic_name: publisher
                for publisher in publishers
                if publisher.topic_name in wanted
            }
            assert set(listeners) == wanted
            for topic, publisher in listeners.items():
                already = 1 if '/clean/' in topic or topic.endswith(DEPTH) else 0
                camera.spin_until(
                    lambda p=publisher, n=already: p.get_subscription_count() > n, topic
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
        with flexx2(
            child_env,
            'replay',
            bag,
            '--topics',
            '*/clean/*',
            '--wait',
            PATIENCE,
            '--rate',
            '0.2',
            '--no-clock',
        ) as process:
            camera.spin_until(lambda: len(camera.messages(DEPTH)) == 12, 'the camera again')
            finish(process)
        for seen, frame in zip(camera.depths(), recorded.depth, strict=True):
            np.testing.assert_array_equal(seen, frame)


@pytest.mark.parametrize('odd', [CameraInfo, Image])
def test_a_stamp_of_another_clock_does_not_stop_replay(odd, source, child_env, tmp_path):
    """Assert it for a camera info that was sent once, and for an image before a clock ran."""
    from rclpy.serialization import serialize_message

    bag, start = tmp_path / 'bag', 1_700_000_000 * SECOND
    name = f'/odd_{os.getpid()}_{odd.__name__}'
    kinds = {'camera_info': CameraInfo, 'depth_image': Image}
    wall = np.ones((43, 56), np.float32)
    with BagWriter(bag) as writer:
        for key, kind, stamps in (
            ('camera_info', CameraInfo, [0 if odd is CameraInfo else start]),
            ('depth_image', Image, [0 if odd is Image else start, start + STEP, start + 2 * STEP]),
        ):
            for index, stamp in enumerate(stamps):
                message = (
                    info_message(streams.FLEXX2, stamp)
                    if kind is CameraInfo
                    else image_message(wall, stamp)
                )
                received = start + index * STEP
                writer.write(
                    f'{name}/clean/{key}',
                    f'sensor_msgs/msg/{kind.__name__}',
                    received,
                    bytes(serialize_message(message)),
                )
    with flexx2(child_env, 'replay', bag, '--wait', PATIENCE) as process:
        heard = [
            source.listener.listen(f'{name}/clean/{key}', kind) for key, kind in kinds.items()
        ]
        source.listener.spin_until(lambda: [len(one) for one in heard] == [1, 3], 'the whole bag')
        finish(process)


def test_replay_without_a_topic(tmp_path):
    from flexx2_sim_ros.nodes.player import Player

    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/a', 'sensor_msgs/msg/Image', 0, b'\x00\x01\x00\x00' + bytes(40))
    with pytest.raises(InputError, match='topics: must match .*/a.*, got none'):
        Player(Bag(tmp_path / 'bag'), ['/b'], True)

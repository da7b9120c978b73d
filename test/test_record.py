"""`flexx2 record` as a process, over real DDS."""

import signal
import sys

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, recording_cameras
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_writer import BagWriter
from flexx2_sim_ros.recording.sink import BagSink
from geometry_msgs.msg import TransformStamped
from mcap.reader import make_reader
import numpy as np
from programs import PATIENCE, started, until
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from recorders import finish, flexx2, rows, SECOND, Source, STEP
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
import streams
from streams import image_message
import yaml

pytestmark = pytest.mark.usefixtures('ros')

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def listener():
    with streams.listening() as found:
        yield found


@pytest.fixture
def source(listener):
    """Return cameras that are there and have published nothing yet."""
    return Source(listener)


@pytest.mark.parametrize(
    ('storage', 'number'), [('mcap', signal.SIGINT), ('sqlite3', signal.SIGTERM)]
)
def test_a_recording_has_all_topics_and_messages(storage, number, source, child_env, tmp_path):
    bag = tmp_path / 'bag'
    with flexx2(
        child_env, 'record', bag, '--storage', storage, '--cameras', *source.cameras
    ) as process:
        source.wait()
        source.publish(40)
        source.settle()
        text = finish(process, number)

    report = rows(text)
    assert '0 messages lost' in text
    for topic in source.publishers:
        messages, _, rate, _, lost, gaps = report[topic]
        assert (messages, rate, lost, gaps) == ('40', '60.00', '0', '0')
    if storage == 'mcap':
        check_compressed(bag / 'bag.mcap', source)
    whole = Bag(bag)
    assert whole.notes == []
    assert (bag / 'metadata.yaml').is_file()
    assert recording_cameras(bag) == source.names
    for camera, name in zip(source.cameras, source.names, strict=True):
        recording = load_recording(bag, name)
        np.testing.assert_array_equal(
            recording.depth, source.pixels(f'{camera}/flexx2_camera/depth_image_0')
        )
        for values, topic in (
            (recording.clean_depth, 'clean/depth_image'),
            (recording.reflectivity, 'clean/reflectivity'),
        ):
            assert values is not None
            np.testing.assert_array_equal(values, source.pixels(f'{camera}/{topic}'))
        assert recording.stamp_ns.tolist() == [SECOND + index * STEP for index in range(40)]
        np.testing.assert_array_equal(recording.K, streams.FLEXX2.matrix)
        assert recording.notes == ()


def check_compressed(path, source):
    """Read a file with the library of its format, which decompresses chunks and checks them."""
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert {chunk.compression for chunk in summary.chunk_indexes} == {'zstd'}
        read = {topic: [] for topic in source.publishers}
        for _, channel, message in reader.iter_messages(list(read)):
            read[channel.topic].append(message.data)
    for topic, sent in source.sent.items():
        kind = type(sent[0])
        assert [deserialize_message(data, kind) for data in read[topic]] == sent, topic


def test_a_full_disk_ends_the_recording(source, child_env, tmp_path):
    bag = tmp_path / 'bag'
    limited = (
        'import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (3 << 20,) * 2); '
        'from flexx2_sim_ros.cli.main import main; sys.exit(main())'
    )
    words = [sys.executable, '-c', limited, 'record', bag, '--cameras', *source.cameras]
    with started(words, env=child_env) as process:
        source.wait()
        source.publish(10)
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2, err
    assert f'{bag}: cannot be written: ' in err
    assert 'Traceback' not in err
    assert 'messages lost' in out
    recording = load_recording(bag, source.names[0])
    assert recording.notes
    assert 1 <= len(recording.depth) < 10


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_killed_recorder_leaves_what_it_had(storage, source, child_env, tmp_path):
    bag = tmp_path / 'bag'
    name = source.names[0]

    def frames():
        try:
            return len(load_recording(bag, name).depth)
        except InputError:
            return 0

    with flexx2(
        child_env, 'record', bag, '--storage', storage, '--cameras', *source.cameras
    ) as process:
        source.wait()
        source.publish(20)
        until(lambda: frames() == 20, 'frames on the disk')
        source.publish(5)
        process.kill()
    recording = load_recording(bag, name)
    count = len(recording.depth)
    assert 20 <= count <= 25
    assert recording.notes, 'it is said that the bag is not whole'
    np.testing.assert_array_equal(
        recording.depth, source.pixels(f'{source.cameras[0]}/flexx2_camera/depth_image_0')[:count]
    )


def test_losses_are_counted_in_the_table_and_in_the_bag(source, child_env, tmp_path):
    bag = tmp_path / 'bag'
    # Room for camera infos only: every image is refused.
    with flexx2(child_env, 'record', bag, '--queue', 0.1, '--cameras', *source.cameras) as process:
        source.wait()
        source.publish(10)
        source.settle()
        text = finish(process, signal.SIGINT)
    for topic, cells in rows(text).items():
        if topic in source.publishers:
            expected = ('10', '0') if topic.endswith('info') else ('0', '10')
            assert (cells[0], cells[4]) == expected, topic
    images = sum(not topic.endswith('info') for topic in source.publishers)
    assert f'{10 * images} messages lost ({10 * images} because' in text
    note = next(note for note in Bag(bag).notes if 'lost while it was recorded' in note)
    assert f'10 of {source.cameras[0]}/clean/depth_image' in note


def test_losses_on_the_way_are_counted(listener, tmp_path):
    from flexx2_sim_ros.nodes.recorder import Recorder

    source = Source(listener, depth=5)
    topic = f'{source.cameras[0]}/clean/depth_image'
    with BagSink(BagWriter(tmp_path / 'bag'), 1 << 30) as sink:
        # Another executor's node: it does not listen while this test does not want it to.
        slow = streams.Listener()
        recorder = Recorder(sink, source.cameras, [])
        slow.add(recorder)
        slow.spin_until(lambda: topic in recorder.topics, 'discovery')
        publisher = source.publishers[topic]
        slow.spin_until(publisher.get_subscription_count, 'subscription')

        def send(*numbers):
            for number in numbers:
                message = image_message(np.ones((2, 2), 'f4'), SECOND + number * STEP)
                publisher.publish(message)

        send(0)
        statistics = recorder.topics[topic]
        slow.spin_until(lambda: statistics.messages == 1, 'first message')
        send(*range(1, 201))  # more than anybody keeps
        slow.spin_until(lambda: statistics.messages + statistics.numbers.lost == 201, 'the rest')
        assert statistics.numbers.lost > 0
        assert statistics.refused == 0
        gaps = statistics.gaps()
        assert gaps.count >= 1
        assert gaps.longest > 2 / 60
        recorder.destroy_node()
        slow.close()
    assert len(list(Bag(tmp_path / 'bag').messages({topic}))) == 201 - statistics.numbers.lost


def test_a_camera_of_any_name_is_found_by_an_info_that_was_sent_once(
    listener, child_env, tmp_path
):
    bag, space = tmp_path / 'bag', '/latched_info/tof'
    infos = listener.node.create_publisher(streams.CameraInfo, f'{space}/camera_info', LATCHED)
    images = listener.node.create_publisher(streams.Image, f'{space}/image_raw', 10)
    infos.publish(streams.info_message(streams.FLEXX2, SECOND))
    frame = np.full((172, 224), 1.25, 'f4')
    sent = []
    with flexx2(child_env, 'record', bag, '--seconds', 0.5) as process:
        # It ends half a second after the first message, or after 30 s without one.
        while process.poll() is None:
            sent.append(SECOND + len(sent) * STEP)
            images.publish(image_message(frame, sent[-1]))
            listener.spin_for_a_message()
        finish(process)
    recording = load_recording(bag)
    assert set(recording.stamp_ns.tolist()) <= set(sent)
    np.testing.assert_array_equal(recording.depth[0], frame)
    np.testing.assert_array_equal(recording.K, streams.FLEXX2.matrix)


def test_what_was_asked_for_is_kept_without_a_camera(listener, child_env, tmp_path):
    bag = tmp_path / 'bag'
    clock = listener.node.create_publisher(Clock, '/clock', 100)

    def recorded():
        clock.publish(Clock())
        try:
            return bag.exists() and len(list(Bag(bag).messages({'/clock'}))) > 5
        except InputError:  # Nothing is in the bag yet.
            return False

    with flexx2(child_env, 'record', bag, '--also', '/clock', '--cameras', 'none') as process:
        listener.spin_until(recorded, 'messages')
        finish(process, signal.SIGINT)
    assert len(list(Bag(bag).messages({'/clock'}))) > 5


def test_nothing_to_record(child_env, tmp_path):
    with flexx2(
        child_env, 'record', tmp_path / 'bag', '--wait', 0.2, '--cameras', 'nobody'
    ) as process:
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2, err
    assert f'{tmp_path / "bag"}: nothing was recorded' in err
    assert 'Traceback' not in err
    assert list(tmp_path.iterdir()) == []


def test_frames_are_recorded_and_replayed_with_their_qos(source, child_env, tmp_path):
    """Assert it of `/tf_static`, `/tf` and `/clock`, which are recorded beside the cameras."""
    listener, bag = source.listener, tmp_path / 'bag'
    node = listener.node
    # tf2_msgs is not among the packages that pip installs; the topic's name and QoS count.
    static = node.create_publisher(TransformStamped, '/tf_static', LATCHED)
    clock = node.create_publisher(Clock, '/clock', BEST_EFFORT)
    moving = node.create_publisher(TransformStamped, '/tf', 10)
    frame = TransformStamped()
    frame.child_frame_id = 'optical'
    static.publish(frame)  # before anybody records
    with flexx2(child_env, 'record', bag, '--cameras', *source.cameras) as process:
        source.wait()
        listener.spin_until(moving.get_subscription_count, '/tf')
        listener.spin_until(clock.get_subscription_count, '/clock')
        for _ in range(5):
            moving.publish(frame)
            clock.publish(Clock())
        source.publish(3)
        source.settle()
        assert '/clock: is published as best effort' in process.stderr.readline()
        finish(process, signal.SIGINT)
    for publisher in (static, clock, moving, *source.publishers.values()):
        node.destroy_publisher(publisher)

    offers = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    offered = {
        item['topic_metadata']['name']: item['topic_metadata']['offered_qos_profiles']
        for item in offers['topics_with_message_count']
    }
    assert all(offered.values())
    assert {item['durability'] for item in offered['/tf_static']} == {'transient_local'}
    assert {item['reliability'] for item in offered['/tf_static']} == {'reliable'}
    assert offered['/tf_static'][0]['lifespan'] == {'sec': 9223372036, 'nsec': 854775807}
    assert {item['reliability'] for item in offered['/clock']} == {'best_effort'}
    assert {item['durability'] for item in offered['/tf']} == {'volatile'}
    single = next(file for file in bag.iterdir() if file.suffix != '.yaml')
    with Reader(bag) as whole, Reader(single) as alone:
        assert {item.topic: item.ext for item in whole.connections} == {
            item.topic: item.ext for item in alone.connections
        }
    assert Bag(bag).latched == {'/tf_static'}

    with flexx2(child_env, 'replay', bag, '--loop', '--wait', '0') as process:
        early = listener.listen(source.cameras[0] + '/clean/camera_info', streams.CameraInfo)
        listener.spin_until(lambda: len(early) > 3, 'the second time round')
        # Who comes late has it all the same.
        late = []
        node.create_subscription(TransformStamped, '/tf_static', late.append, LATCHED)
        listener.spin_until(lambda: late, 'frames that were sent before')
        assert late[0] == frame
        finish(process, signal.SIGINT)


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['record', '{}'], 'got one that exists'),
        (['record', '{}/a.npz'], "a folder whose name has no ending, got '.npz'"),
        (['record', '{}/a', '--seconds', '-1'], '--seconds'),
        (['record', '{}/a', '--queue', 'nan'], '--queue'),
        (
            ['record', '{}/a', '--storage', 'sqlite3', '--compression', 'zstd'],
            '--compression: must be none with --storage sqlite3, got zstd',
        ),
        (['replay', '{}/none'], 'got a path that does not exist'),
        (['replay', '{}', '--rate', '0'], '--rate: must be'),
        (['replay', '{}', '--wait', '-1'], '--wait'),
    ],
)
def test_bad_arguments_end_the_command_before_it_starts(words, message, tmp_path, capsys):
    assert main([word.format(tmp_path) for word in words]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []

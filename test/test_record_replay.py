"""`flexx2 record` and `flexx2 replay` as processes, over real DDS."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import itertools
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, recording_cameras
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_writer import BagWriter
from flexx2_sim_ros.recording.sink import BagSink
import numpy as np
import pytest
from rclpy.duration import Duration
import streams
from streams import CameraInfo, Clock, DEPTH, Image, image_message, info_message, nanoseconds

pytestmark = pytest.mark.usefixtures('ros')

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 60.0
SECOND = 1_000_000_000
STEP = SECOND // 60
CAMERAS = ('left', 'right')
_numbers = itertools.count()


def until(condition: Callable[[], Any], what: str) -> None:
    """Wait for what another process does."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f'{what}: did not come about within {PATIENCE} s'
        time.sleep(0.01)


@contextmanager
def flexx2(child_env: dict[str, str], *words: object) -> Iterator[subprocess.Popen[str]]:
    """Run the command as a process, which is over at the end of the block."""
    with subprocess.Popen(
        [sys.executable, '-m', 'flexx2_sim_ros.cli.main', *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=child_env | {'COLUMNS': '200'},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def finish(process: subprocess.Popen[str], number: signal.Signals | None = None) -> str:
    """End a process, if it does not by itself, and return what it printed; all has to be well."""
    if number is not None:
        process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == (0 if number is None else 128 + number), err
    assert 'Traceback' not in err
    return out


class Source:
    """What two cameras publish, frame by frame; every frame is another."""

    def __init__(self, listener: streams.Listener, depth: int = 1000) -> None:
        """Open the topics; names are this source's own."""
        space = f'/source_{next(_numbers)}'
        self.cameras = [f'{space}/{name}' for name in CAMERAS]
        self.listener = listener
        kinds = {
            'clean/camera_info': CameraInfo,
            'flexx2_camera/camera_info': CameraInfo,
            'clean/depth_image': Image,
            'clean/reflectivity': Image,
            'flexx2_camera/depth_image_0': Image,
        }
        self.publishers = {
            f'{camera}/{topic}': listener.node.create_publisher(kind, f'{camera}/{topic}', depth)
            for camera in self.cameras
            for topic, kind in kinds.items()
        }
        self.sent: dict[str, list[Any]] = {topic: [] for topic in self.publishers}

    @property
    def names(self) -> list[str]:
        """Return the cameras' names."""
        return [camera.strip('/') for camera in self.cameras]

    def wait(self) -> None:
        """Wait until every topic has a subscriber."""
        self.listener.spin_until(
            lambda: all(
                publisher.get_subscription_count() for publisher in self.publishers.values()
            ),
            'subscribers',
        )

    def publish(self, count: int) -> None:
        """Publish the next frames."""
        first = len(next(iter(self.sent.values())))
        for index in range(first, first + count):
            rng = np.random.default_rng(index)
            for topic, publisher in self.publishers.items():
                stamp = SECOND + index * STEP
                if topic.endswith('info'):
                    message: Any = info_message(streams.FLEXX2, stamp)
                else:
                    pixels = rng.uniform(0.1, 7.0, (172, 224)).astype('f4')
                    message = image_message(pixels, stamp)
                publisher.publish(message)
                self.sent[topic].append(message)

    def settle(self) -> None:
        """Wait until everything has reached its subscribers."""
        for topic, publisher in self.publishers.items():
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE)), topic

    def pixels(self, topic: str) -> np.ndarray:
        """Return what was published, (T, H, W)."""
        return np.stack([streams.array_of(message) for message in self.sent[topic]])


@pytest.fixture
def source() -> Iterator[Source]:
    """Return cameras that are there and say nothing yet."""
    listener = streams.Listener()
    yield Source(listener)
    listener.close()


def rows(text: str) -> dict[str, list[str]]:
    """Return the report's cells by topic: messages, from, rate, MB, lost, gaps."""
    return {
        line.split()[0]: line.split()[1:] for line in text.splitlines() if line.startswith('/')
    }


@pytest.mark.parametrize(
    ('storage', 'number'), [('mcap', signal.SIGINT), ('sqlite3', signal.SIGTERM)]
)
def test_a_recording_has_all_topics_and_messages(
    storage: str, number: signal.Signals, source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
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


def test_replay_gives_the_same_messages_and_their_time(
    source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
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


def test_recorded_clean_depth_gives_the_recorded_camera(
    child_env: dict[str, str], tmp_path: Path
) -> None:
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
        assert recorded.amplitude is not None
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


def whole(bag: Path, count: int) -> bool:
    """Say whether a bag that is being written has so many frames, all else, and the mode."""
    try:
        recording = load_recording(bag)
    except InputError:
        return False
    # The first note is that there is no metadata yet, the second that the file has no end.
    return (
        len(recording.depth) == count
        and len(recording.notes) == 2
        and (recording.usecase is not None)
    )


def test_a_full_disk_ends_the_recording(
    source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    limited = (
        'import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (3 << 20,) * 2); '
        'from flexx2_sim_ros.cli.main import main; sys.exit(main())'
    )
    with subprocess.Popen(
        [sys.executable, '-c', limited, 'record', bag, '--cameras', *source.cameras],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=child_env,
    ) as process:
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
def test_killed_recorder_leaves_what_it_had(
    storage: str, source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    name = source.names[0]

    def frames() -> int:
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


def test_losses_are_counted_in_the_table_and_in_the_bag(
    source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
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


def test_losses_on_the_way_are_counted(tmp_path: Path) -> None:
    from flexx2_sim_ros.nodes.recorder import Recorder

    listener = streams.Listener()
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

        def send(count: int) -> None:
            for _ in range(count):
                number = len(source.sent[topic])
                message = image_message(np.ones((2, 2), 'f4'), SECOND + number * STEP)
                source.sent[topic].append(message)
                publisher.publish(message)

        send(1)
        statistics = recorder.topics[topic]
        slow.spin_until(lambda: statistics.messages == 1, 'first message')
        send(200)  # more than anybody keeps
        slow.spin_until(lambda: statistics.messages + statistics.numbers.lost == 201, 'the rest')
        assert statistics.numbers.lost > 0
        assert statistics.refused == 0
        gaps = statistics.gaps()
        assert gaps.count >= 1
        assert gaps.longest > 2 / 60
        recorder.destroy_node()
        slow.close()
    listener.close()
    assert len(list(Bag(tmp_path / 'bag').messages({topic}))) == 201 - statistics.numbers.lost


def test_one_camera_is_recorded_for_some_time(
    source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    with flexx2(
        child_env, 'record', bag, '--seconds', 0.2, '--cameras', source.cameras[0]
    ) as process:
        topic = f'{source.cameras[0]}/clean/depth_image'
        source.listener.spin_until(source.publishers[topic].get_subscription_count, 'recorder')
        source.publish(3)
        text = finish(process)
    assert f'{bag}: ' in text
    assert len(list(Bag(bag).messages({topic}))) == 3


def test_nothing_to_record(child_env: dict[str, str], tmp_path: Path) -> None:
    with flexx2(
        child_env, 'record', tmp_path / 'bag', '--wait', 0.2, '--cameras', 'nobody'
    ) as process:
        _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2, err
    assert f'{tmp_path / "bag"}: nothing was recorded' in err
    assert 'Traceback' not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['record', '{}'], 'got one that exists'),
        (['record', '{}/a', '--seconds', '-1'], '--seconds'),
        (['record', '{}/a', '--queue', 'nan'], '--queue'),
        (['replay', '{}/none'], 'got a path that does not exist'),
        (['replay', '{}', '--rate', '0'], '--rate: must be'),
        (['replay', '{}', '--wait', '-1'], '--wait'),
    ],
)
def test_bad_arguments_end_the_command_before_it_starts(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.format(tmp_path) for word in words]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_replay_loops_until_it_is_stopped(
    source: Source, child_env: dict[str, str], tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    topic = f'/loop_{next(_numbers)}/clean/camera_info'
    with BagWriter(bag) as writer:
        from rclpy.serialization import serialize_message

        for index in range(5):
            stamp = SECOND + index * STEP
            writer.write(
                topic,
                'sensor_msgs/msg/CameraInfo',
                stamp,
                bytes(serialize_message(info_message(streams.FLEXX2, stamp))),
            )
    with flexx2(child_env, 'replay', bag, '--loop', '--rate', 10) as process:
        heard = source.listener.listen(topic, CameraInfo)
        source.listener.spin_until(lambda: len(heard) > 12, 'three rounds')
        finish(process, signal.SIGTERM)
    stamps = [nanoseconds(message) for message in heard]
    start = stamps.index(SECOND)
    expected = itertools.cycle(SECOND + index * STEP for index in range(5))
    assert stamps[start:] == list(itertools.islice(expected, len(stamps) - start))


def test_replay_without_a_topic(tmp_path: Path) -> None:
    from flexx2_sim_ros.nodes.player import Player

    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/a', 'sensor_msgs/msg/Image', 0, b'\x00\x01\x00\x00' + bytes(40))
    with pytest.raises(InputError, match='topics: must match .*/a.*, got none'):
        Player(Bag(tmp_path / 'bag'), ['/b'], True)

"""Recording to a bag: what is lost is counted."""

import sqlite3
import threading

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_remains import Message
from flexx2_sim_ros.recording.bag_writer import BagWriter
from flexx2_sim_ros.recording.sink import BagSink, find_gaps
import made_bags
from made_bags import camera_entries, depths, SECOND, STORAGES
import pytest


class SlowWriter(BagWriter):
    """A bag on a disk that stands still until it is told to go on."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.go = threading.Event()
        self.taken = threading.Event()

    def write(self, topic, kind, time, data):
        self.taken.set()
        assert self.go.wait(30)
        super().write(topic, kind, time, data)


def some_messages(count):
    for time in range(count):
        yield Message('/a', 'sensor_msgs/msg/Image', time, bytes([time]) * 100)


@pytest.mark.parametrize('storage', STORAGES)
def test_full_queue_refuses_and_keeps_the_order(storage, tmp_path):
    writer = SlowWriter(tmp_path / 'bag', storage)
    sink = BagSink(writer, capacity=450)
    taken = [sink.put(message) for message in some_messages(50)]
    assert taken == [True] * 4 + [False] * 46
    assert sink.waiting == 400
    writer.go.set()
    sink.close()
    assert [message.data[0] for message in Bag(tmp_path / 'bag').messages()] == [0, 1, 2, 3]


def test_warnings_of_the_writer_become_notes(tmp_path):
    entries = camera_entries('left', depths(1, 5, 4), depths(1, 5, 4))
    with BagSink(BagWriter(tmp_path / 'bag'), 1 << 20) as sink:
        for topic, kind, received, message in entries:
            assert sink.put(
                Message(topic, kind, received, bytes(made_bags.TYPES.serialize_cdr(message, kind)))
            )
        sink.remarks['flexx2_lost'] = '3 of /left/clean/depth_image'
    assert any(
        'lost while it was recorded: 3 of /left' in note
        for note in load_recording(tmp_path / 'bag').notes
    )


@pytest.mark.parametrize(
    'failure',
    [
        OSError(28, 'No space left on device'),
        sqlite3.OperationalError('disk I/O error'),
        ValueError('a surprise'),
    ],
)
def test_a_disk_that_fails_is_reported(failure, tmp_path, monkeypatch):
    writer = BagWriter(tmp_path / 'bag')
    real = writer.write

    def fail(topic, kind, time, data):
        if time == 3:
            raise failure
        real(topic, kind, time, data)

    monkeypatch.setattr(writer, 'write', fail)
    sink = BagSink(writer, 1 << 20)
    for message in some_messages(10):
        sink.put(message)
    with pytest.raises(InputError, match='bag: (no space|cannot be written: .*(I/O|surprise))'):
        sink.close()
    assert not sink.put(next(some_messages(1)))


STEP = SECOND // 60


@pytest.mark.parametrize(
    ('stamps', 'count', 'longest'),
    [
        ([i * STEP for i in range(300)], 0, 0.0),
        ([i * STEP for i in range(300) if i not in (50, 51, 200)], 2, 3 / 60),
        ([i * STEP for i in range(300) if i != 1], 1, 2 / 60),
        ([i * STEP for i in range(300) if i != 298], 1, 2 / 60),
        ([i * STEP for i in range(300) if i % 4 != 3], 0, 0.0),  # 45 Hz out of 60 Hz
        ([i * STEP for i in range(300) if i < 150 or i % 2], 0, 0.0),  # 60 Hz, then 30 Hz
        ([i * STEP + int(2e6 * (i * 7919 % 100) / 100) for i in range(300)], 0, 0.0),  # jitter
        ([5], 0, 0.0),
        ([], 0, 0.0),
    ],
)
def test_gaps(stamps, count, longest):
    gaps = find_gaps(stamps)
    assert gaps.count == count
    assert gaps.longest == pytest.approx(longest, abs=1e-6)
    assert gaps.returns == 0


def test_stamps_that_go_back_are_not_counted_as_gaps():
    stamps = [i * STEP for i in range(60)] * 2 + [59 * STEP]
    assert find_gaps(stamps).count == 0
    assert find_gaps(stamps).returns == 2

"""Images that arrive late, over real DDS: with true stamps, in the time of the node's clock."""

import time

from flexx2_sim_ros.nodes.late_frames import LateFrames
from flexx2_sim_ros.nodes.messages import time_message
import pytest
from rclpy.node import Node
from streams import (
    array_of,
    boards,
    Clock,
    DEPTH,
    Image,
    image_message,
    INFO,
    info_message,
    library,
    nanoseconds,
    same,
    SECOND,
    START,
    stream,
)

MS = SECOND // 1000
LATE = {'effect.time_offset.strength': 1.0, 'effect.time_offset.latency': 0.0}

pytestmark = pytest.mark.usefixtures('ros')


def hear_with_times(seen):
    """Listen to depth images; return the list of messages and when DDS received them."""
    heard = []

    def take(message, info):
        heard.append((message, info['received_timestamp']))

    subscription = seen.node.create_subscription(Image, f'{seen.name}/{DEPTH}', take, 50)
    seen.spin_until(subscription.get_publisher_count, 'publisher')
    seen.spin_until(
        lambda: (
            seen.node.count_subscribers(f'{seen.name}/{DEPTH}') == 1
            and seen.camera._outputs.wanted
        ),
        'subscription',
    )
    return heard


def feed(seen, stamp):
    """Send clean depth without waiting for the frame."""
    seen.publish(image=image_message(boards(), stamp), info=info_message(seen.source, stamp))


def clock_of(seen):
    """Return a function that publishes the simulated time in nanoseconds."""
    clocks = seen.node.create_publisher(Clock, '/clock', 10)
    seen.spin_until(clocks.get_subscription_count, 'clock of the node')
    return lambda now: clocks.publish(Clock(clock=time_message(now)))


def test_an_image_arrives_no_earlier_than_its_delay_and_keeps_its_stamp():
    delays = 0.15, 0.02
    with stream(usecase='Mode_5_60fps', **LATE) as seen:
        heard = hear_with_times(seen)
        stamps = []
        for delay in delays:
            assert seen.set(**{'effect.time_offset.delay': delay}).successful
            for _ in range(3):
                stamps.append(time.time_ns())
                feed(seen, stamps[-1])
                seen.spin_until(lambda: time.time_ns() > stamps[-1] + 30 * MS)
        seen.spin_until(lambda: len(heard) == len(stamps), 'all images')
        assert [nanoseconds(message) for message, _ in heard] == stamps
        for (message, received), stamp in zip(heard, stamps, strict=True):
            delay = delays[stamps.index(stamp) // 3]
            assert received - stamp >= delay * 1e9
            assert same(array_of(message), library(seen, boards(), stamp).depth)
        assert not seen.logged('time_offset.delay')


def test_in_simulated_time_an_image_arrives_at_its_stamp_plus_the_delay():
    with stream(
        DEPTH, INFO, use_sim_time=True, **LATE, **{'effect.time_offset.delay': 0.1}
    ) as seen:
        publish = clock_of(seen)

        def set_clock(now):
            publish(now)
            seen.spin_until(lambda: seen.camera.get_clock().now().nanoseconds == now, 'clock')
            for _ in range(3):  # The timers of the node run.
                seen.spin_for_a_message()

        for k, stamp in enumerate((5 * SECOND, 5 * SECOND + 50 * MS)):
            set_clock(stamp + 10 * MS)
            feed(seen, stamp)
            seen.spin_until(lambda k=k: seen.camera._statistics.received == k + 1, 'input')
        set_clock(5 * SECOND + 99 * MS)
        assert not seen.messages(DEPTH)
        for k, stamp in enumerate((5 * SECOND, 5 * SECOND + 50 * MS)):
            set_clock(stamp + 100 * MS)
            seen.spin_until(lambda k=k: len(seen.messages(DEPTH)) == k + 1, 'image')
            seen.spin_until(lambda k=k: len(seen.messages(INFO)) == k + 1, 'camera info')
            assert nanoseconds(seen.messages(DEPTH)[k]) == stamp
        # A simulation that starts again forgets the images that are under way.
        feed(seen, 6 * SECOND)
        feed(seen, 2 * SECOND)
        seen.spin_until(lambda: seen.camera._statistics.received == 4, 'inputs')
        set_clock(8 * SECOND)
        seen.spin_until(lambda: len(seen.messages(DEPTH)) == 3, 'image')
        assert nanoseconds(seen.messages(DEPTH)[2]) == 2 * SECOND


def test_stamps_of_another_clock_are_said_and_the_image_still_waits():
    with stream(**LATE, **{'effect.time_offset.delay': 0.1}) as seen:
        heard = hear_with_times(seen)
        for k in range(2):
            before = time.time_ns()
            feed(seen, START + k * SECOND)
            seen.spin_until(lambda k=k: len(heard) == k + 1, 'image')
            assert heard[k][1] - before >= 100 * MS
        seen.spin_until(lambda: seen.logged('time_offset.delay', 'use_sim_time'), 'warning')
        assert len(seen.logged('time_offset.delay')) == 1


@pytest.mark.parametrize(
    ('values', 'step', 'reason'),
    [
        ({}, 0, 'header.stamp: must be new for every image, got the same'),
        ({}, 1, 'images were not due'),
        (
            {'use_sim_time': True, **LATE, 'effect.time_offset.delay': 0.1},
            SECOND,
            'frames wait for their delay, and the clock of this node is at 0 ns',
        ),
    ],
)
def test_input_that_gives_no_frames_is_an_error_until_it_does(values, step, reason):
    with stream(INFO, **values) as seen:
        stamps = iter(range(START, START + 10_000 * max(step, 1), max(step, 1)))
        report = seen.next_diagnostics()
        while reason not in report.message:
            feed(seen, next(stamps) if step else START)
            report = seen.next_diagnostics()
        assert report.level == report.ERROR
        assert ('Actual frequency (Hz)', '0.00') in [(v.key, v.value) for v in report.values]
        assert report.message.startswith('no frame is published: ')
        if 'use_sim_time' in values:
            clock_of(seen)(START + 20_000 * SECOND)
        else:
            feed(seen, START + SECOND)
        while seen.next_diagnostics().message.startswith('no frame is published: '):
            pass


def test_no_more_frames_wait_than_come_until_the_new_one_is_due():
    """Assert it of a delay of 30 s at 10 Hz, and that as many wait when a shorter one follows."""
    node = Node('waits')
    try:
        late, stamp = LateFrames(node), node.get_clock().now().nanoseconds
        for delay in (30, 29):
            for _ in range(400):
                late.add(stamp, delay * SECOND, 10.0, lambda: None)
            assert late.waiting == pytest.approx(300 + 16, abs=1)
    finally:
        node.destroy_node()


def test_a_time_before_zero_is_ignored():
    with stream(DEPTH, use_sim_time=True) as seen:
        publish = clock_of(seen)
        publish(-SECOND)
        seen.spin_until(lambda: seen.logged('/clock: sec: must be 0 or more, got -1'), 'warning')
        publish(5 * SECOND)
        seen.spin_until(lambda: seen.camera.get_clock().now().nanoseconds == 5 * SECOND, 'clock')
        assert seen.show(boards(), START)

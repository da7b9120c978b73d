"""The camera node on real topics: what a user of the vendor's driver relies on, and more."""

import math

from flexx2_sim_ros.camera.frame import gray_image
from flexx2_sim_ros.processing import load_chain
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
import streams
from streams import (
    array_of,
    boards,
    CLOUD,
    DEPTH,
    FLEXX2,
    GRAY,
    INFO,
    INPUT_HZ,
    input_stamps,
    library,
    nanoseconds,
    NOISE,
    same,
    SECOND,
    SMALL,
    SMALL_INFO,
    START,
    stream,
    WHITE,
)

pytestmark = pytest.mark.usefixtures('ros')


def test_the_mode_changes_between_two_frames():
    """Assert that each frame is wholly of one mode and comes at its rate."""
    old, new = (flexx2().mode(name) for name in ('Mode_5_60fps', 'Mode_9_30fps'))
    with stream(DEPTH, NOISE, usecase=old.name.upper(), seed=3) as seen:
        assert seen.get('usecase') == old.name
        assert seen.get('available_usecases') == [mode.name for mode in flexx2().modes]
        stamps = iter(input_stamps(40 * INPUT_HZ))

        def feed(count):
            for _ in range(count):
                seen.show(boards(), next(stamps))

        feed(8 * INPUT_HZ // 60)
        refused = seen.set(usecase='Mode_7_30fps')
        assert not refused.successful
        assert all(mode.name in refused.reason for mode in flexx2().modes)
        assert 'Mode_7_30fps' in refused.reason
        assert seen.get('usecase') == old.name
        before = len(seen.depths())
        answer = seen.clients.set_parameters(
            [streams.Parameter('usecase', value=f' {new.name.swapcase()} ')]
        )
        while not answer.done():
            feed(1)
        assert answer.result().results[0].successful
        after = len(seen.depths())
        feed(6 * INPUT_HZ // 30)
        assert seen.get('usecase') == new.name

        modes = [_mode_of(seen, index, (old, new)) for index in range(len(seen.depths()))]
        first = modes.index(new)
        assert before <= first <= after
        assert modes == [old] * first + [new] * (len(modes) - first)
        frames = [nanoseconds(message) for message in seen.messages(DEPTH)]
        _check_rate(frames[:first], old)
        _check_rate(frames[after:], new)


def _mode_of(seen, index, modes):
    """Return the mode in which the library makes this frame, bit for bit."""
    depth, noise = seen.messages(DEPTH)[index], seen.messages(NOISE)[index]
    for mode in modes:
        frame = library(seen, boards(), nanoseconds(depth), mode.name)
        if same(array_of(depth), frame.depth) and same(array_of(noise), frame.sigma):
            return mode
    return None


def _check_rate(stamps, mode):
    # Inputs come in steps of 1/240 s: a frame is that late at most, and lateness does not add up.
    assert len(stamps) >= 5
    for count, stamp in enumerate(stamps):
        due = stamps[0] + count * SECOND / mode.rate_hz
        assert abs(stamp - due) < 1.01 * SECOND / INPUT_HZ


def test_the_node_publishes_the_librarys_frames_bit_for_bit():
    with stream(DEPTH, INFO, CLOUD, GRAY, NOISE, seed=5, camera_name='left') as seen:
        stamp = START + 1
        assert seen.show(boards(), stamp, frame_id='lens')
        frame = library(seen, boards(), stamp)
        assert seen.camera.settings.camera_name == 'left'
        assert same(seen.depths()[0], frame.depth)
        assert same(array_of(seen.messages(NOISE)[0]), frame.sigma)
        gray = seen.messages(GRAY)[0]
        assert gray.encoding == 'mono8'
        assert same(array_of(gray), gray_image(frame.amplitude, None, WHITE))

        cloud = seen.messages(CLOUD)[0]
        assert (cloud.width, cloud.height) == (224, 172)
        assert (cloud.point_step, cloud.row_step) == (16, 3584)
        assert not cloud.is_bigendian
        assert not cloud.is_dense
        assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
            (name, 4 * i, streams.PointField.FLOAT32, 1)
            for i, name in enumerate(('x', 'y', 'z', 'conf'))
        ]
        points = np.frombuffer(cloud.data, '<f4').reshape(172, 224, 4)
        v, u = np.mgrid[:172, :224]
        np.testing.assert_allclose(points[..., 0], (u - 111.5) / FLEXX2.fx * frame.depth, 1e-5)
        np.testing.assert_allclose(points[..., 1], (v - 85.5) / FLEXX2.fy * frame.depth, 1e-5)
        assert same(points[..., 2], frame.depth)
        assert same(points[..., 3], frame.confidence)
        headers = [seen.messages(topic)[0].header for topic in (DEPTH, INFO, CLOUD, GRAY, NOISE)]
        assert all(header == headers[0] for header in headers)
        assert headers[0].frame_id == 'lens'
        info = seen.messages(INFO)[0]
        assert (info.width, info.height, info.distortion_model) == (224, 172, 'plumb_bob')
        k = [FLEXX2.fx, 0, 111.5, 0, FLEXX2.fy, 85.5, 0, 0, 1]
        assert list(info.k) == k
        assert list(info.d) == [0.0] * 5
        assert list(info.r) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
        assert list(info.p) == [*k[:3], 0, *k[3:6], 0, *k[6:], 0]


def test_invalid_value_and_frame_id():
    with stream(DEPTH, NOISE, CLOUD) as seen:
        seen.show(boards(), START, frame_id='from_input')
        assert seen.set(invalid_value='zero').successful
        assert seen.set(frame_id='mine').successful
        assert seen.get('invalid_value') == 'zero'
        seen.show(boards(), START + SECOND, frame_id='from_input')
        refused = seen.set(invalid_value='minus one')
        assert not refused.successful
        assert 'nan, zero' in refused.reason
        assert [m.header.frame_id for m in seen.messages(CLOUD)] == ['from_input', 'mine']
        frame = library(seen, boards(), START + SECOND)
        expected = np.nan_to_num(frame.depth)
        assert same(seen.depths()[1], expected)
        assert same(array_of(seen.messages(NOISE)[1]), np.nan_to_num(frame.sigma))
        points = np.frombuffer(seen.messages(CLOUD)[1].data, '<f4').reshape(172, 224, 4)
        assert same(points[..., 2], expected)
        # A command line makes a number of it.
        assert seen.set(invalid_value=math.nan).successful
        assert seen.get('invalid_value') == 'nan'


def test_exposure_darkens_the_gray_image():
    with stream(GRAY, DEPTH, auto_exposure_0=False) as seen:
        seen.show(boards(), START)
        assert seen.set(exposure_time_0=92).successful
        seen.show(boards(), START + SECOND)
        frame = library(seen, boards(), START + SECOND)
        gray = array_of(seen.messages(GRAY)[1])
        assert same(gray, gray_image(frame.amplitude, 92 / 370, WHITE))
        assert gray.mean() < 0.6 * array_of(seen.messages(GRAY)[0]).mean()
        assert same(seen.depths()[1], frame.depth)


def test_slow_input_is_passed_on_and_reported():
    """Assert every image of a 10 Hz stream comes through, and one warning names both rates."""
    with stream(DEPTH, usecase='Mode_5_60fps') as seen:
        stamps = input_stamps(30, hz=10)
        assert all(seen.show(boards(), stamp) for stamp in stamps)
        report = seen.next_diagnostics()
        assert report.level == streams.DiagnosticStatus.WARN
        assert '10.0 Hz' in report.message
        assert 'slower' in report.message
        for step in range(40):  # Still too slow, but not as slow as before.
            seen.show(boards(), stamps[-1] + (step + 1) * SECOND // 20)
        assert 'slower' in seen.next_diagnostics().message
        assert len(seen.logged('Mode_5_60fps', '60 Hz', 'slower')) == 1


def test_diagnostics_count_frames_and_losses():
    with stream(DEPTH, usecase='Mode_9_10fps', serial='A-17') as seen:
        for stamp in input_stamps(121):
            seen.show(boards(), stamp)
        seen.show(boards(), stamp)
        seen.show(boards(), 1, encoding='mono8')
        seen.show(boards(), 1)
        report = seen.next_diagnostics()
        values = {pair.key: pair.value for pair in report.values}
        assert report.name == f'{seen.name.lstrip("/")}: camera'
        assert report.hardware_id == 'A-17'
        assert values['usecase'] == 'Mode_9_10fps'
        assert float(values['Target frequency (Hz)']) == 10
        counted = {
            'inputs received': '124',
            'frames published': '7',
            "inputs dropped (not due at the mode's rate)": '115',
            'inputs dropped (repeated stamp)': '1',
            'inputs rejected': '1',
            'stamps went back': '1',
        }
        assert values | counted == values
        assert float(values['invalid share']) == pytest.approx(0.5, abs=0.05)
        assert 0 < float(values['latency mean [ms]']) <= float(values['latency max [ms]'])
        # A second without a frame has no latency, however many images were looked at.
        for tick in range(2, 12):
            assert not seen.show(boards(), tick)
        values = {pair.key: pair.value for pair in seen.next_diagnostics().values}
        assert values['latency mean [ms]'] == 'nan'


def test_quality_of_service():
    """Assert reliable publishers, inputs that follow theirs, and that both can be overridden."""
    overrides = {
        'qos_overrides./own/flexx2_camera/gray_image_0.publisher.reliability': 'best_effort',
        'qos_overrides./own/clean/camera_info.subscription.reliability': 'best_effort',
    }
    with stream(namespace='/own', **overrides) as seen:
        for topic in (DEPTH, INFO, CLOUD, GRAY, NOISE):
            name = f'{seen.name}/{topic}'
            seen.spin_until(lambda: seen.node.get_publishers_info_by_topic(name))  # noqa: B023
            qos = seen.node.get_publishers_info_by_topic(name)[0].qos_profile
            assert qos.reliability.name == ('BEST_EFFORT' if topic == GRAY else 'RELIABLE')
            assert qos.durability.name == 'VOLATILE'
            assert seen.camera.has_parameter(f'qos_overrides.{name}.publisher.reliability')
        for topic in ('depth_image', 'camera_info', 'reflectivity'):
            name = f'{seen.camera.get_namespace()}/clean/{topic}'
            seen.spin_until(lambda: seen.node.get_subscriptions_info_by_topic(name))  # noqa: B023
            qos = seen.node.get_subscriptions_info_by_topic(name)[0].qos_profile
            expected = 'BEST_EFFORT' if topic == 'camera_info' else 'RELIABLE'
            assert qos.reliability.name == expected
            assert qos.durability.name == 'VOLATILE'
            value = seen.get(f'qos_overrides.{name}.subscription.reliability')
            assert value == ('best_effort' if topic == 'camera_info' else 'best_available')


def test_parameters_of_the_driver():
    with stream() as seen:
        assert seen.get('usecase') == 'Mode_9_30fps'
        assert seen.get('model') == 'Flexx2'
        for name, value in (
            ('model', 'x'),
            ('serial', 'x'),
            ('available_usecases', ['x']),
            ('seed', 4),
        ):
            assert not seen.set(**{name: value}).successful
        assert not seen.set(usecase=3).successful
        assert not seen.logged('was not measured')
        for usecase in ('Mode_5_15fps', 'Mode_9_30fps', 'Mode_5_15fps'):
            assert seen.set(usecase=usecase).successful
        seen.spin_until(lambda: len(seen.logged('usecase is now')) == 3)
        assert len(seen.logged('Mode_5_15fps', 'was not measured', 'Mode_5_30fps')) == 1


def test_each_subscription_of_another_quality_of_service_is_a_warning():
    lasting = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with stream(DEPTH) as seen:
        for topic in (GRAY, NOISE):
            seen.node.create_subscription(
                Image, f'{seen.name}/{topic}', lambda message: None, lasting
            )
            seen.spin_until(lambda topic=topic: seen.logged(topic, 'incompatible QoS'), topic)


def test_depth_is_processed_as_a_file_says(tmp_path):
    """Assert the node and `Chain` agree, over frames and where stamps go back."""
    path = tmp_path / 'chain.yaml'
    path.write_text(
        'schema: 1\nprocess: [{crop: {left: 24}}, {decimate: {factor: 4}}, '
        '{spatial: {radius: 4}}, {smooth: {persistency: 3}}, {fill: {method: inpaint}}, '
        '{fill: {method: temporal}}, {normalise: {high: 2.0}}]\n'
    )
    with stream(DEPTH, SMALL, SMALL_INFO, usecase='Mode_9_30fps', process=str(path)) as seen:
        stamps = [START + k * SECOND // 30 for k in range(5)]
        for stamp in (*stamps, START - SECOND):
            seen.show(boards(), stamp)
        chain = load_chain(path)
        wanted = [
            chain.step(depth, stamp)
            for depth, stamp in zip(seen.depths(), (*stamps, START - SECOND), strict=True)
        ]
        found = [array_of(message) for message in seen.messages(SMALL)]
        np.testing.assert_array_equal(found, wanted)
        info = seen.messages(SMALL_INFO)[-1]
        small = chain.lens(FLEXX2)
        assert (info.width, info.height) == (50, 43)
        np.testing.assert_allclose(np.reshape(info.k, (3, 3)), small.matrix)
        assert info.header == seen.messages(SMALL)[-1].header

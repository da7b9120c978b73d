"""The camera node, fed by processes that know nothing of this package and its shared memory."""

from contextlib import closing
import sys

from diagnostic_msgs.msg import DiagnosticStatus
from flexx2_sim_ros.nodes.runtime import PROFILE_VARIABLES
import numpy as np
from programs import ROOT, starting
import pytest
from rclpy.qos import qos_profile_sensor_data
from streams import boards, DEPTH, Image, image_message, SECOND, START, Stream, stream

PUBLISHER = ROOT / 'test' / 'plain_publisher.py'
_SPACES = iter(f'/plain_{number}' for number in range(100))

pytestmark = pytest.mark.usefixtures('ros')


@pytest.fixture
def publish(child_env):
    """Return a function that starts a publisher; those that still run are killed at the end."""
    env = {name: value for name, value in child_env.items() if name not in PROFILE_VARIABLES}
    with starting(env=env) as run:
        yield lambda namespace, *options: run([sys.executable, PUBLISHER, namespace, *options])


class Fed(Stream):
    """A camera node at 60 Hz whose input comes from elsewhere."""

    def __init__(self, namespace, **values):
        """Start the node."""
        super().__init__(DEPTH, namespace=namespace, feed=False, usecase='Mode_5_60fps', **values)

    @property
    def received(self):
        """How many images have come."""
        return self.camera._statistics.received

    def quality(self, topic):
        """Return what the node asks of a topic."""
        profile = self.camera._inputs[topic]._subscription.qos_profile
        return profile.reliability.name, profile.durability.name

    def report_until(self, condition):
        """Return the first report that meets a condition."""
        for _ in range(60):
            report = self.next_diagnostics()
            if condition(report):
                return report
        raise AssertionError(f'the last report was: {report.message}')


@pytest.fixture
def fed():
    """Return a camera node that nobody publishes to."""
    with closing(Fed(next(_SPACES))) as made:
        yield made


def space(fed):
    """Return the node's namespace."""
    return fed.camera.get_namespace()


def test_large_images_of_a_reliable_publisher_arrive(fed, publish):
    """Assert VGA images, more than the publisher's shared memory holds, arrive without a setup."""
    process = publish(space(fed), '--size', '640x480', '--rate', '10', '--count', '20')
    fed.spin_until(lambda: process.poll() is not None, 'publisher')
    fed.spin_until(lambda: fed.received + fed.camera._inputs['clean/depth_image'].lost >= 20)
    # On a machine that is busy with something else one may be late for good.
    assert fed.received >= 18
    assert fed.quality('clean/depth_image')[0] == 'RELIABLE'


def test_losses_of_a_best_effort_publisher_are_reported(fed, publish):
    small = publish(space(fed), '--best-effort', '--count', '30')
    fed.spin_until(lambda: small.poll() is not None, 'publisher')
    assert fed.received >= 27
    assert fed.quality('clean/depth_image')[0] == 'BEST_EFFORT'
    large = publish(space(fed), '--best-effort', '--size', '1920x1080', '--count', '30')
    report = fed.report_until(lambda report: 'are lost on the way' in report.message)
    assert report.level != DiagnosticStatus.OK  # an error once all were lost for three seconds
    assert 'config/fastdds.xml' in report.message
    fed.spin_until(lambda: large.poll() is not None, 'publisher')
    values = {pair.key: pair.value for pair in fed.next_diagnostics().values}
    assert int(values['messages lost (clean/depth_image)']) > 0
    fed.spin_until(lambda: fed.logged('clean/depth_image', 'lost on the way', 'fastdds.xml'))
    # And then it is no longer news.
    fed.report_until(lambda report: 'lost' not in report.message)


def test_publishers_that_come_and_go_are_followed(fed):
    topic = 'clean/depth_image'

    def offer(quality):
        return fed.node.create_publisher(Image, f'{space(fed)}/{topic}', quality)

    reliable, best_effort = offer(10), offer(qos_profile_sensor_data)
    fed.spin_until(lambda: fed.quality(topic)[0] == 'BEST_EFFORT', 'both')
    for publisher in (reliable, best_effort):
        fed.spin_until(publisher.get_subscription_count, 'matched')
    fed.node.destroy_publisher(best_effort)
    fed.spin_until(lambda: fed.quality(topic)[0] == 'RELIABLE', 'reliable')
    fed.spin_until(reliable.get_subscription_count, 'matched')
    reliable.publish(image_message(boards(), START))
    fed.spin_until(lambda: fed.received == 1)


def test_parameters_fix_the_quality(publish):
    namespace = next(_SPACES)
    name = f'qos_overrides.{namespace}/clean/depth_image.subscription'
    values = {f'{name}.reliability': 'reliable', f'{name}.depth': 3}
    with closing(Fed(namespace, **values)) as fed:
        assert fed.get(f'{name}.durability') == 'best_available'
        publish(namespace, '--best-effort')
        fed.spin_until(lambda: fed.logged('qos_overrides', 'no message of it arrives'))
        fed.spin_until(lambda: fed.quality('clean/camera_info')[0] == 'BEST_EFFORT')
        assert fed.quality('clean/depth_image')[0] == 'RELIABLE'
        assert fed.received == 0


def test_latched_camera_info_sent_before_the_node_starts(publish):
    namespace = next(_SPACES)
    process = publish(namespace, '--latched-info', '--rate', '10', '--count', '100')
    assert process.stdout.readline() == 'ready\n'
    with closing(Fed(namespace)) as fed:
        fed.spin_until(lambda: fed.published >= 18, 'frames')
        assert fed.quality('clean/camera_info') == ('RELIABLE', 'TRANSIENT_LOCAL')
        assert fed.quality('clean/depth_image') == ('RELIABLE', 'VOLATILE')


def feed(seen, value, start, count=12):
    """Show a wall at the mode's rate."""
    image = np.full((172, 224), value, np.float32)
    for index in range(count):
        seen.show(image, start + index * SECOND // 60)


def test_missing_input_is_reported_until_it_arrives_again():
    with stream(DEPTH, usecase='Mode_5_60fps') as seen:
        feed(seen, 1500.0, START)
        report = seen.next_diagnostics()
        assert report.level == DiagnosticStatus.WARN
        assert 'values of about 1500' in report.message
        assert 'looks like millimetres' in report.message
        assert '32FC1 must be metres (REP 118)' in report.message
        feed(seen, np.inf, START + 2 * SECOND)
        report = seen.next_diagnostics()
        assert report.level == DiagnosticStatus.OK
        assert 'no pixel has a return (+inf 100%)' in report.message
        feed(seen, 1.5, START + 4 * SECOND)
        report = seen.next_diagnostics()
        assert (report.level, report.message) == (DiagnosticStatus.OK, 'streaming')
        seen.spin_until(lambda: seen.logged('the input is fine again'))
        for part in ('looks like millimetres', 'no pixel has a return'):
            assert len(seen.logged(part)) == 1


def test_the_rates_recover_at_once_after_a_jump_of_the_clock():
    jump = 1000 * SECOND
    with stream(DEPTH, usecase='Mode_5_60fps') as seen:
        feed(seen, 1.5, START, 130)
        before = seen.published
        feed(seen, 1.5, START + jump + 130 * SECOND // 60, 12)
        assert seen.published == before + 12
        report = seen.next_diagnostics()
        values = {pair.key: pair.value for pair in report.values}
        assert float(values['input rate [Hz]']) == pytest.approx(60, rel=1e-3)
        assert float(values['Actual frequency (Hz)']) == pytest.approx(60, rel=1e-3)
        assert (report.level, report.message) == (DiagnosticStatus.OK, 'streaming')


def test_reflectivity_of_other_stamps_is_reported():
    with stream(DEPTH, usecase='Mode_5_60fps') as seen:
        image = np.full((172, 224), 1.5, np.float32)
        for index in range(40):
            stamp = START + index * SECOND // 60
            seen.publish(reflectivity=image_message(image, stamp + 1))
            seen.show(image, stamp)
        report = seen.next_diagnostics()
        values = {pair.key: pair.value for pair in report.values}
        assert int(values['reflectivity without a depth image of its stamp']) >= 20
        assert report.level == DiagnosticStatus.WARN
        assert 'clean/reflectivity: none has the stamp of a depth image' in report.message


def test_a_topic_that_nobody_publishes_is_named(fed):
    report = fed.next_diagnostics()
    assert report.level == DiagnosticStatus.ERROR
    assert report.message == 'no input: clean/depth_image has no publisher'
    publisher = fed.node.create_publisher(Image, f'{space(fed)}/clean/depth_image', 10)
    fed.report_until(lambda report: report.message == 'no input')
    assert publisher.get_subscription_count() == 1

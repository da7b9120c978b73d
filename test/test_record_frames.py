"""`/tf_static`, `/tf` and `/clock` beside the cameras: recorded by default, replayed alike."""

import signal

from flexx2_sim_ros.recording.bag_files import Bag
from geometry_msgs.msg import TransformStamped
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from recorders import finish, flexx2, open_source
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
import streams
import yaml

pytestmark = pytest.mark.usefixtures('ros')

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
# tf2_msgs is not among the packages that pip installs; the topic's name and QoS are what counts.
KIND = TransformStamped


@pytest.fixture
def source():
    with open_source() as found:
        yield found


def test_frames_are_recorded_and_replayed_with_their_qos(
    source,  # noqa: F811
    child_env,
    tmp_path,
):
    listener, bag = source.listener, tmp_path / 'bag'
    node = listener.node
    static = node.create_publisher(KIND, '/tf_static', LATCHED)
    clock = node.create_publisher(Clock, '/clock', BEST_EFFORT)
    moving = node.create_publisher(KIND, '/tf', 10)
    frame = KIND()
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
        node.create_subscription(KIND, '/tf_static', late.append, LATCHED)
        listener.spin_until(lambda: late, 'frames that were sent before')
        assert late[0] == frame
        finish(process, signal.SIGINT)

"""The node of `flexx2 view` over real DDS: the frames that it pairs, and driving."""

from dataclasses import dataclass
import json
from typing import Any

from flexx2_sim_ros.nodes.viewer import Viewer
from geometry_msgs.msg import Twist
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from streams import CameraInfo, FLEXX2, Image, image_message, info_message, Listener, Parameter

WIDE = FLEXX2.from_field_of_view(80, 60, 100.0, 80.0)
CLEAN = np.full((60, 80), 1.5, np.float32)


@dataclass
class Watched:
    """A viewer of one of two cameras, and what publishes for that camera."""

    user: Listener
    viewer: Viewer
    send: dict[str, Any]
    other: Any

    def watch(self):
        """Open a page, as far as the viewer can see."""
        self.viewer.watch(True)
        self.user.spin_until(
            lambda: all(publisher.get_subscription_count() for publisher in self.send.values()),
            'subscriptions',
        )

    def show(self, stamp, clean):
        """Publish a frame, return what the viewer makes of it."""
        if clean:
            self.send['clean/camera_info'].publish(info_message(WIDE, stamp))
            self.send['clean/depth_image'].publish(image_message(CLEAN, stamp))
        self.send['flexx2_camera/camera_info'].publish(info_message(FLEXX2, stamp))
        image = np.full((172, 224), 1.25, np.float32)
        image[:86] = np.nan
        self.send['flexx2_camera/depth_image_0'].publish(image_message(image, stamp))
        self.user.spin_until(
            lambda: (
                (shots := self.viewer.shots)
                and all(shot.stamp == stamp for shot in shots.values())
            ),
            'the frame',
        )
        return self.viewer.shots['view_parts/left']

    def show_until(self, fits, first):
        """Show frames with clean depth until the viewer has one that fits."""
        for stamp in range(first, first + 200):
            shot = self.show(stamp, clean=True)
            if shot.clean is not None and fits(shot):
                return shot
        raise AssertionError('no such frame')


@pytest.fixture
def watched(ros):
    """Return a viewer that looks for the camera view_parts/left, not yet at it."""
    user, viewer = Listener(), Viewer(['left'], '/view_parts/cmd_vel')
    user.add(viewer)
    try:
        send = {
            topic: user.node.create_publisher(kind, f'/view_parts/left/{topic}', 10)
            for topic, kind in (
                ('clean/depth_image', Image),
                ('clean/camera_info', CameraInfo),
                ('flexx2_camera/depth_image_0', Image),
                ('flexx2_camera/camera_info', CameraInfo),
            )
        }
        other = user.node.create_publisher(
            Image, '/view_parts/right/flexx2_camera/depth_image_0', 10
        )
        viewer._wanted = {'view_parts/left'}
        user.spin_until(lambda: 'view_parts/left' in viewer._cameras, 'the camera')
        yield Watched(user, viewer, send, other)
    finally:
        user.close()
        viewer.destroy_node()


def test_frames_are_paired_and_looked_up_as_the_camera_does(watched):
    user, viewer, send = watched.user, watched.viewer, watched.send
    # Cameras that were not asked for are not shown. Without a page, nothing is subscribed.
    assert not any(publisher.get_subscription_count() for publisher in send.values())
    watched.watch()
    assert watched.other.get_subscription_count() == 0
    # Both ends discover each other at different times: best effort may miss the first frames.
    shot = watched.show_until(lambda shot: True, 1)
    assert shot.clean.shape == shot.simulated.shape == (172, 224)
    np.testing.assert_allclose(shot.clean, 1.5, rtol=1e-5)
    assert shot.invalid_fraction == 0.5
    # The real driver has no clean depth.
    assert watched.show(10_000, clean=False).clean is None
    # Nor a latency: it is that of the images with clean depth.
    camera = viewer._cameras['view_parts/left']
    assert camera.status()['latency_ms'] > 0
    camera._latencies.clear()
    watched.show(10_001, clean=False)
    assert camera.status()['latency_ms'] is None
    viewer.watch(False)
    user.spin_until(lambda: not viewer.shots, 'rest')


def test_a_late_image_is_shown_with_the_clean_depth_of_its_stamp(watched):
    watched.watch()
    watched.show_until(lambda shot: True, 1)
    waiting = watched.viewer._cameras['view_parts/left']._clean
    for stamp in range(1000, 1060):  # Two seconds of frames.
        message = image_message(CLEAN, stamp)

        def arrived(stamp=stamp, message=message):
            watched.send['clean/depth_image'].publish(message)
            return stamp in waiting

        watched.user.spin_until(arrived, 'clean depth')
    assert watched.show(1000, clean=False).clean is not None


def test_a_camera_info_that_was_sent_once_is_known(watched):
    user, topic = watched.user, '/view_parts/left/clean/camera_info'
    user.node.destroy_publisher(watched.send['clean/camera_info'])
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    watched.send['clean/camera_info'] = user.node.create_publisher(CameraInfo, topic, latched)
    watched.send['clean/camera_info'].publish(info_message(WIDE, 0))

    def publishers():
        found = watched.viewer.get_publishers_info_by_topic(topic)
        return [one.qos_profile.durability for one in found]

    user.spin_until(lambda: publishers() == [DurabilityPolicy.TRANSIENT_LOCAL], 'the publisher')
    watched.watch()
    for stamp in range(1, 200):
        watched.send['clean/depth_image'].publish(image_message(CLEAN, stamp))
        shot = watched.show(stamp, clean=False)
        if shot.clean is not None:
            break
    np.testing.assert_allclose(shot.clean, 1.5, rtol=1e-5)


def test_clean_depth_follows_the_parameter_input_depth(watched):
    user = watched.user
    events = user.node.create_publisher(ParameterEvent, '/parameter_events', 10)
    user.spin_until(events.get_subscription_count, 'a subscription to parameter events')
    watched.watch()
    first = 1
    for value, corner in (('radial', 1.249), ('planar', 1.5)):
        event = ParameterEvent(node='/view_parts/left/flexx2_camera')
        event.changed_parameters = [Parameter('input_depth', value=value).to_parameter_msg()]
        events.publish(event)
        shot = watched.show_until(lambda shot, z=corner: abs(shot.clean[0, 0] - z) < 1e-3, first)
        assert shot.clean[86, 112] == pytest.approx(1.5, abs=1e-3)
        first += 1000


def test_a_mode_is_asked_for_until_it_is_answered_and_shown_until_another_is(watched):
    user, seen = watched.user, []
    name, unheard = 'flexx2_camera', ['--ros-args', '-r', '/parameter_events:=/view_parts/events']
    events = user.node.create_publisher(ParameterEvent, '/parameter_events', 10)
    silent = Node(name, namespace='/view_parts/left', cli_args=unheard)  # Nothing spins it.
    user.spin_until(lambda: watched.viewer._cameras['view_parts/left'].ask_at, 'a question')
    silent.destroy_node()
    node = Node(name, namespace='/view_parts/left', cli_args=unheard)
    node.declare_parameters('', [('usecase', 'a'), ('available_usecases', ['a', 'b'])])
    user.add(node)

    def shows(usecase):
        (camera,) = json.loads(watched.viewer.status)['cameras']
        seen.append(camera['usecases'])
        return camera['usecase'] == usecase

    try:
        user.spin_until(lambda: shows('a'), 'the mode')
        user.spin_until(events.get_subscription_count, 'a subscription to parameter events')
        node.set_parameters([Parameter('usecase', value='b')])
        seen.clear()
        restarted = [Parameter('usecase', value='b').to_parameter_msg()]
        events.publish(ParameterEvent(node=f'/view_parts/left/{name}', new_parameters=restarted))
        user.spin_until(lambda: shows('b'), 'the new mode')
        assert [['a', 'b']] * len(seen) == seen
    finally:
        node.destroy_node()


def test_wrong_messages_of_pages_are_one_log_line(watched):
    for _ in range(15):
        watched.viewer.complain('page at 127.0.0.1: wrong')
    watched.user.spin_until(lambda: any('wrong' in entry.msg for entry in watched.user.log))
    assert sum('wrong' in entry.msg for entry in watched.user.log) == 1


def test_a_browser_that_falls_silent_stops_the_robot(ros):
    user, viewer = Listener(), Viewer(['none'], '/view_silent/cmd_vel')
    user.add(viewer)
    try:
        heard = user.listen('/view_silent/cmd_vel', Twist)
        user.spin_until(lambda: viewer._twist.get_subscription_count(), 'a listener')
        viewer.drive('me', (9.0, -9.0, 99.0))
        user.spin_until(lambda: len(heard) == 2, 'the stop')
        assert (heard[0].linear.x, heard[0].linear.y, heard[0].angular.z) == (1.2, -1.2, 2.5)
        assert heard[1] == Twist()
        viewer.drive('me', (0.1, 0.0, 0.0))
        viewer.leave('me')
        user.spin_until(lambda: len(heard) == 4, 'another stop')
    finally:
        user.close()
        viewer.destroy_node()

"""The robot node that follows another simulator or another clock, over real DDS."""

import itertools
import math

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.robots.parts import JointNames
import numpy as np
import pytest
from robots import (
    CameraInfo,
    Clock,
    exact,
    Image,
    JOINTS,
    joints,
    JointState,
    Odometry,
    odometry,
    robot_messages,
    robot_node,
    Twist,
    twist,
)
from streams import array_of, nanoseconds

pytestmark = pytest.mark.usefixtures('ros')


def test_another_simulator_moves_the_robot():
    stamp = 1_700_000_000 * 10**9 + 123_456_789
    angles = np.tile([0.1, 1.0, -1.7], 4)
    with robot_node(robot='go2', motion='external') as seen:
        poses, states = seen.to('odom', Odometry), seen.to('joint_states', JointState)
        images = seen.hear('front_left/clean/depth_image', Image)
        infos = seen.hear('front_left/clean/camera_info', CameraInfo)
        # Nobody spoke of joints yet: the pose is shown at once.
        poses.publish(odometry(stamp, (0.2, 0.1, 0.3), 0.1))
        seen.spin_until(lambda: images, 'an image')
        assert nanoseconds(images[0]) == stamp
        # From then on a pose waits for the joints of its moment, in any order and spelling.
        order = np.random.default_rng(0).permutation(12)
        names = [
            name.removesuffix('_joint') if k % 2 else f'go1/{name}'
            for k, name in enumerate(np.array(JOINTS)[order])
        ]
        later = stamp + 17_000_000
        states.publish(joints(stamp, angles, JOINTS))
        data, trunk = seen.robot._data, seen.robot._parts.trunk
        seen.spin_until(lambda: data.qpos[8] == 1.0, 'joints')
        poses.publish(odometry(later, (0.3, 0.1, 0.3), 0.2))
        states.publish(joints(later, angles[order] + 0.1, names))
        seen.spin_until(lambda: len(images) == len(infos) == 2, 'an image')
        assert [nanoseconds(message) for message in images] == [stamp, later]
        assert [nanoseconds(message) for message in infos] == [stamp, later]
        np.testing.assert_allclose(data.xpos[trunk], [0.3, 0.1, 0.3], atol=1e-9)
        np.testing.assert_allclose(data.qpos[7:], angles + 0.1, atol=1e-12)
        expected, _ = seen.robot._renderer.render(data, 'front_left')
        np.testing.assert_array_equal(array_of(images[-1]), expected)
        # Poses without new joints are shown by the next one; those too close are left out.
        for after, x in ((17_000_000, 0.4), (18_000_000, 9.9), (34_000_000, 0.5)):
            poses.publish(odometry(later + after, (x, 0.1, 0.3)))
        seen.spin_until(lambda: len(images) == 3, 'an image')
        assert nanoseconds(images[-1]) == later + 17_000_000
        np.testing.assert_allclose(data.xpos[trunk], [0.4, 0.1, 0.3], atol=1e-9)
        # What is another simulator's to say is not said here.
        names = [publisher.topic_name for publisher in seen.robot.publishers]
        assert not [one for one in names if one.endswith(('/clock', '/odom', '/joint_states'))]
        answer = seen.reset()
        assert not answer.success
        assert 'reset it there' in answer.message
        assert 'the simulator that has the time' in seen.set(real_time_factor=2.0).reason


def test_after_a_reset_of_the_other_simulator_a_pose_waits_for_new_joints():
    before, after = np.tile([0.1, 1.0, -1.7], 4), np.tile([0.2, 0.8, -1.5], 4)
    with robot_node(motion='external') as seen:
        poses, states = seen.to('odom', Odometry), seen.to('joint_states', JointState)
        images = seen.hear('front_left/clean/depth_image', Image)
        data = seen.robot._data
        states.publish(joints(9 * 10**9, before))
        seen.spin_until(lambda: data.qpos[8] == before[1], 'joints')
        poses.publish(odometry(9 * 10**9, (0.3, 0.1, 0.3)))
        seen.spin_until(lambda: images, 'an image')
        poses.publish(odometry(10**9, (0.1, 0.1, 0.3)))
        seen.spin_until(lambda: seen.robot._motion._waiting, 'a pose that waits')
        states.publish(joints(10**9, after))
        seen.spin_until(lambda: len(images) == 2, 'an image')
        assert nanoseconds(images[1]) == 10**9
        np.testing.assert_allclose(data.qpos[7:], after, atol=1e-12)
        # The simulator may send the joints first.
        states.publish(joints(10**8, before))
        seen.spin_until(lambda: data.qpos[8] == before[1], 'joints')
        poses.publish(odometry(10**8, (0.2, 0.1, 0.3)))
        seen.spin_until(lambda: len(images) == 3, 'an image')
        assert nanoseconds(images[2]) == 10**8


def test_invalid_messages_of_another_simulator_are_reported_and_ignored():
    with robot_node(motion='external') as seen:
        poses, states = seen.to('odom', Odometry), seen.to('joint_states', JointState)
        images = seen.hear('front_left/clean/depth_image', Image)
        some = ('FR_hip_joint', 'FR_tail_joint', 'arm')
        for stamp in (1, 2):
            states.publish(joints(stamp, (0.2, 0.1, 0.3), some))
        seen.spin_until(lambda: seen.logged('no message named so far: FL_calf_joint, FL_hip'))
        states.publish(joints(3, (0.1, 0.2), ('FR_hip_joint', 'FR_0')))
        twice = "joint_states: name: must have every joint once, got 'FR_hip_joint' and 'FR_0'"
        seen.spin_until(lambda: seen.logged(twice))
        poses.publish(odometry(10**9, (0.1, math.nan, 0.3)))
        seen.spin_until(lambda: seen.logged('odom: pose.pose.position', 'finite'))
        poses.publish(odometry(2 * 10**9, (0.1, 0.0, 0.3)))
        poses.publish(odometry(3 * 10**9, (0.1, 0.0, 0.3)))
        seen.spin_until(lambda: images, 'an image')
        assert nanoseconds(images[0]) == 2 * 10**9
        assert seen.robot._data.joint('FR_hip_joint').qpos[0] == 0.2
        assert len(seen.logged('does not have: FR_tail_joint, arm')) == 1
        assert len(seen.logged('no message named')) == 1


@pytest.mark.parametrize(
    ('message', 'said'),
    [
        (joints(0, (1.0,), ('a', 'b')), 'must have one value for each of the 2 names, got 1'),
        (joints(0, (1.0, math.inf), ('a', 'b')), "position of 'b': must be .*, got inf"),
        (joints(0, (1.0, 1.0), ('x/FR_hip', 'fr_hip_joint')), 'the same joint'),
    ],
)
def test_unusable_joint_states_are_reported(message, said):
    with pytest.raises(InputError, match=said):
        robot_messages.decode_joints(message, 'joint_states', JointNames(JOINTS))


@pytest.mark.parametrize('quaternion', [(0, 0, 0, 0), (2, 0, 0, 0), (math.nan, 0, 0, 1)])
def test_invalid_orientations_are_reported(quaternion):
    message = odometry(0, (0, 0, 0.3))
    turn = message.pose.pose.orientation
    turn.w, turn.x, turn.y, turn.z = map(float, quaternion)
    with pytest.raises(InputError, match='orientation: must be .*norm 1, got'):
        robot_messages.decode_pose(message, 'odom')


def test_the_second_robot_follows_the_first_ones_clock():
    with robot_node(rate=30.0) as first:
        clock = first.hear('/clock', Clock)
        first.more(clock, 5)
        with robot_node(rate=60.0, frame_prefix='second/') as second:
            second.add(first.robot)
            second.spin_until(lambda: second.logged('/clock: another robot publishes it'))
            assert second.node.count_publishers('/clock') == 1
            poses = second.hear('odom', Odometry)
            times = second.hear('/clock', Clock)
            second.more(poses, 30)
            assert exact([nanoseconds(message) for message in poses], 60)
            # Its stamps are the first one's time, not a time of its own.
            now = times[-1].clock.sec * 10**9 + times[-1].clock.nanosec
            assert abs(nanoseconds(poses[-1]) - now) <= 2 * 10**9 // 30
            answer = second.set(real_time_factor=2.0)
            assert not answer.successful
            assert 'must be set where /clock is published' in answer.reason
            # Time that jumps back is followed as well.
            first.robot._pacer.tick = 0
            before = len(poses)
            second.spin_until(
                lambda: any(nanoseconds(message) < 10**8 for message in poses[before:]),
                'time from 0',
            )


def test_robots_whose_clocks_have_other_names_have_a_time_each():
    with (
        robot_node('/clock:=/left/clock', rate=30.0) as left,
        robot_node('/clock:=/right/clock', rate=60.0) as right,
    ):
        right.add(left.robot)
        for seen, name, rate in ((left, '/left/clock', 30), (right, '/right/clock', 60)):
            times, poses = right.listen(name, Clock), right.listen(f'{seen.space}/odom', Odometry)
            right.spin_until(lambda times=times, poses=poses: times and len(poses) > 5, name)
            assert exact([nanoseconds(message) for message in poses], rate)
            assert not seen.logged('another robot publishes it')
        assert right.set(real_time_factor=2.0).successful


def teller(seen):
    """Return a function that tells the time, in tenths of a second."""
    time = seen.node.create_publisher(Clock, '/clock', 10)
    seen.spin_until(lambda: time.get_subscription_count() >= 2, '/clock')

    def tell(tenths):
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(tenths * 10**8, 10**9)
        time.publish(message)
        # More than the tick is to be handled: six poses, and what both nodes hear of it.
        for _ in range(20):
            seen.spin_for_a_message()

    return tell


def test_a_robot_that_uses_sim_time_follows_any_clock():
    with robot_node(use_sim_time=True) as seen:
        poses, tell = seen.hear('odom', Odometry), teller(seen)

        def a_pose_comes():
            tell(next(ticks))
            return poses

        # The first ticks may come before somebody listens to the poses.
        ticks = itertools.count(500)
        seen.spin_until(a_pose_comes, 'the first pose')
        for tenths in itertools.islice(ticks, 4):
            tell(tenths)
            seen.spin_until(lambda now=tenths * 10**8: nanoseconds(poses[-1]) == now, 'poses')
        # Six poses between two ticks of a clock of 10 Hz.
        stamps = [nanoseconds(message) for message in poses]
        assert stamps[0] >= 50 * 10**9
        assert exact(stamps)


def test_a_clock_that_goes_back_ends_a_command():
    with robot_node(motion='cmd_vel', use_sim_time=True) as seen:
        drive = seen.to('cmd_vel', Twist)
        poses, tell = seen.hear('odom', Odometry), teller(seen)

        def speed_at(tenths):
            tell(tenths)
            return poses[-1].twist.twist.linear.x if poses else 0.0

        def walks():
            drive.publish(twist(0.3))
            return speed_at(next(ticks)) > 0.2

        ticks = itertools.count(500)
        seen.spin_until(walks, 'the robot walks')
        # Nobody says stop. The command was to hold until 50 s, which are far ahead now.
        before = len(poses)
        ticks = itertools.count(1)
        seen.spin_until(lambda: abs(speed_at(next(ticks))) < 0.01, 'the robot stands')
        assert next(ticks) < 50
        assert nanoseconds(poses[before]) < 10**9

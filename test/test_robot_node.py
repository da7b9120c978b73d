"""The robot node over real DDS: driven, paused, reset, with its frames and its start."""

import math
import sys
from xml.etree import ElementTree

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.robots.kinematics import feet, rotation
from flexx2_sim_ros.robots.robot import load_mounts
import mujoco
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from robots import (
    CameraInfo,
    Clock,
    exact,
    Image,
    JOINTS,
    JointState,
    Odometry,
    place,
    RATE,
    robot_node,
    RobotUnderTest,
    tf_frames,
    Twist,
    twist,
)
from std_msgs.msg import String
from streams import array_of, nanoseconds

pytestmark = pytest.mark.usefixtures('ros')


@pytest.mark.parametrize('robot', ['go1', 'go2'])
def test_all_messages_of_a_standing_robot_have_one_stamp(robot):
    with robot_node(robot=robot) as seen:
        images = seen.hear('front_left/clean/depth_image', Image)
        infos = seen.hear('front_left/clean/camera_info', CameraInfo)
        clock = seen.hear('/clock', Clock)
        states = seen.hear('joint_states', JointState)
        poses = seen.hear('odom', Odometry)
        seen.more(poses, 20)
        for heard in (images, infos, states, poses):
            assert exact([nanoseconds(message) for message in heard])
        assert exact([message.clock.sec * 10**9 + message.clock.nanosec for message in clock])
        assert {message.header.frame_id for message in images} == {'front_left_optical_frame'}
        assert {message.header.frame_id for message in poses} == {'odom'}
        assert tuple(states[-1].name) == JOINTS
        np.testing.assert_allclose(states[-1].position, [0, 0.9, -1.8] * 4)
        np.testing.assert_allclose(states[-1].velocity, 0, atol=1e-12)
        position, yaw = place(poses[-1])
        height = seen.robot._parts.legs.standing_height
        np.testing.assert_allclose([*position, yaw], [0, 0, height, 0], atol=1e-6)
        assert poses[-1].twist.twist == Twist()


def test_the_robot_follows_cmd_vel_and_stops_without_it():
    with robot_node(robot='go2', motion='cmd_vel') as seen:
        drive = seen.to('cmd_vel', Twist)
        poses, states = seen.hear('odom', Odometry), seen.hear('joint_states', JointState)
        for _ in range(12):
            drive.publish(twist(0.4, 0.0, 0.3))
            seen.more(poses, 6)
        moving = poses[-6:]
        for message in moving:
            assert message.twist.twist.linear.x == pytest.approx(0.4, abs=0.01)
            assert message.twist.twist.angular.z == pytest.approx(0.3, abs=0.01)
        told = nanoseconds(poses[-1])
        seen.more(poses, 90)
        speed = {
            nanoseconds(message): math.hypot(linear.x, linear.y)
            for message, linear in ((one, one.twist.twist.linear) for one in poses)
        }
        # The last command reached the node within a few ticks; it holds half a second more.
        held = [stamp for stamp in speed if told < stamp < told + 0.3e9]
        assert min(speed[stamp] for stamp in held) > 0.38
        assert max(value for stamp, value in speed.items() if stamp > told + 0.9e9) < 1e-6
        assert place(poses[-1])[0][0] > 0.3
        # Odometry and joints are one state: the feet on the ground stay where they are.
        angles = {nanoseconds(message): np.reshape(message.position, (4, 3)) for message in states}
        at = {nanoseconds(message): place(message) for message in poses}
        both = sorted(angles.keys() & at.keys())
        legs = seen.robot._parts.legs
        world = np.array(
            [at[s][0] + feet(angles[s], legs) @ rotation((0, 0, at[s][1])).T for s in both]
        )
        down = world[..., 2] < legs.foot_radius + 1e-4
        slid = np.linalg.norm(np.diff(world, axis=0)[..., :2], axis=-1)[down[1:] & down[:-1]]
        assert slid.max() < 0.002
        assert slid.size > 100
        # Joint velocities are those of the joint positions.
        a, b = states[20], states[21]
        np.testing.assert_allclose(
            b.velocity, (np.array(b.position) - a.position) * RATE, atol=1e-4
        )


def test_a_command_moves_the_robot_at_a_low_rate():
    with robot_node(motion='cmd_vel', scene='rubble', rate=0.8, real_time_factor=4.0) as seen:
        drive, poses = seen.to('cmd_vel', Twist), seen.hear('odom', Odometry)
        # One command moves it for half a second, less what it takes to speed up.
        seen.more(poses, 1)
        drive.publish(twist(0.4))
        seen.spin_until(lambda: place(poses[-1])[0][0] > 0.1, 'walking')
        seen.more(poses, 3)
        assert place(poses[-1])[0][0] < 0.3
        assert poses[-1].twist.twist == Twist()
        for _ in range(10):
            drive.publish(twist(0.4))
            seen.more(poses, 1)
        assert place(poses[-1])[0][0] > 0.5


def test_invalid_cmd_vel_is_reported_and_ignored():
    with robot_node(motion='cmd_vel', scene='rubble') as seen:
        drive, poses = seen.to('cmd_vel', Twist), seen.hear('odom', Odometry)
        for bad in (twist(math.nan), twist(0.0, math.inf), twist(0.0, 0.0, -math.inf)):
            drive.publish(bad)
        seen.spin_until(lambda: seen.logged('cmd_vel: linear.x: must be a finite'))
        seen.more(poses, 5)
        np.testing.assert_allclose(place(poses[-1])[0][:2], 0, atol=1e-9)
        drive.publish(twist(0.4))
        seen.spin_until(lambda: place(poses[-1])[0][0] > 0.05, 'walking')


def test_limits_pause_and_pace_change_while_it_runs():
    with robot_node(motion='cmd_vel', rate=30.0) as seen:
        drive, poses = seen.to('cmd_vel', Twist), seen.hear('odom', Odometry)
        assert seen.set(max_speed=0.1).successful
        for _ in range(6):
            drive.publish(twist(5.0))
            seen.more(poses, 3)
        assert poses[-1].twist.twist.linear.x == pytest.approx(0.1, abs=1e-3)
        assert seen.set(real_time_factor=4.0).successful
        seen.more(poses, 30)
        assert seen.set(paused=True).successful
        tick = seen.robot._pacer.tick
        seen.spin_until(lambda: nanoseconds(poses[-1]) == tick * 10**9 // 30, 'what was sent')
        for _ in range(10):
            seen.spin_for_a_message()
        assert seen.robot._pacer.tick == tick
        assert seen.set(paused=False, real_time_factor=0.5).successful
        seen.more(poses, 5)
        # Whatever the pace and the pauses: one tick after the other.
        assert exact([nanoseconds(message) for message in poses], 30)
        for name, value, said in (
            ('real_time_factor', 0.0, 'must be a number from 0.01 to 100'),
            ('real_time_factor', math.nan, 'got nan'),
            ('max_speed', -1.0, 'must be a number from 0 to 1.2'),
            ('max_turn', 'fast', "got 'fast'"),
            ('board_distance', 2.0, "in scene board only, got scene 'corner'"),
            ('motion', 'stand', 'read'),
        ):
            answer = seen.set(**{name: value})
            assert not answer.successful
            assert said in answer.reason
        # A file of all parameters, as `ros2 param load` reads it, has these as well.
        assert seen.set(board_distance=seen.robot.settings.number('board_distance')).successful
        seen.more(poses, 2)


def test_a_reset_moves_the_robot_back_and_time_goes_on():
    with robot_node(motion='cmd_vel') as seen:
        drive, poses = seen.to('cmd_vel', Twist), seen.hear('odom', Odometry)
        for _ in range(5):
            drive.publish(twist(0.5))
            seen.more(poses, 4)
        assert place(poses[-1])[0][0] > 0.02
        answer = seen.reset()
        assert answer.success
        tick = seen.robot._pacer.tick
        seen.spin_until(lambda: nanoseconds(poses[-1]) > (tick + 2) * 10**9 // RATE, 'poses')
        np.testing.assert_allclose(place(poses[-1])[0][:2], 0, atol=1e-9)
        assert poses[-1].twist.twist == Twist()
        assert exact([nanoseconds(message) for message in poses])


def distance(seen, images, pixel=(86, 112)):
    """Return the depth of a pixel in the first image that is sent from now on."""
    now = seen.robot._pacer.stamp  # Images with this stamp were sent before.
    seen.spin_until(lambda: images and nanoseconds(images[-1]) > now, 'an image')
    return array_of(images[-1])[pixel]


def test_the_board_stays_until_its_parameters_change_or_a_reset():
    with robot_node(scene='board', motion='cmd_vel', rate=30.0) as seen:
        drive = seen.to('cmd_vel', Twist)
        images = seen.hear('front_left/clean/depth_image', Image)
        poses = seen.hear('odom', Odometry)

        def turned_enough():
            drive.publish(twist(turn=1.0))
            return poses and place(poses[-1])[1] > 0.3

        seen.spin_until(turned_enough, 'a turn')
        assert seen.set(max_turn=0.0).successful
        seen.spin_until(lambda: abs(poses[-1].twist.twist.angular.z) < 1e-6, 'a stop')
        turned = distance(seen, images)
        assert abs(turned - 1.0) > 0.02
        # The value that the board has already is no change, as in a file of `ros2 param dump`.
        for values in ({'max_speed': 0.5}, {'real_time_factor': 2.0}, {'board_distance': 1.0}):
            assert seen.set(**values).successful
            assert distance(seen, images) == pytest.approx(turned, abs=2e-3)
        assert seen.set(board_distance=1.2).successful
        assert distance(seen, images) == pytest.approx(1.2, abs=2e-3)
        assert seen.reset().success
        assert distance(seen, images) == pytest.approx(1.2, abs=2e-3)
        assert seen.set(board_distance=2.0, board_angle_deg=60.0).successful
        assert distance(seen, images) == pytest.approx(2.0, abs=0.01)
        assert distance(seen, images, (86, 130)) > 2.2
        assert not seen.set(board_distance=99.0).successful


def test_frames_follow_the_conventions_of_ros():
    left, right = load_mounts()
    found = {
        message.child_frame_id: message
        for message in tf_frames.camera_transforms('base', (left, right))
    }
    cameras = ('front_left', 'front_right')
    assert set(found) == {
        f'{one}_{frame}' for one in cameras for frame in ('link', 'optical_frame')
    }

    def matrix(message):
        turn = message.transform.rotation
        result = np.empty(9)
        mujoco.mju_quat2Mat(result, np.array([turn.w, turn.x, turn.y, turn.z]))
        return result.reshape(3, 3)

    for mount in (left, right):
        link = found[f'{mount.name}_link']
        assert link.header.frame_id == 'base'
        moved = link.transform.translation
        np.testing.assert_allclose([moved.x, moved.y, moved.z], mount.position)
        # x of the link is the optical axis, and all optical axes are the mount's.
        np.testing.assert_allclose(matrix(link)[:, 0], mount.rotation[:, 2], atol=1e-9)
        optical = found[f'{mount.name}_optical_frame']
        assert optical.header.frame_id == f'{mount.name}_link'
        np.testing.assert_allclose(matrix(link) @ matrix(optical), mount.rotation, atol=1e-9)


def test_without_tf2_the_log_says_so_once(monkeypatch):
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    with robot_node() as seen:
        poses = seen.hear('odom', Odometry)
        seen.more(poses, 5)
        seen.spin_until(lambda: seen.logged('tf2_msgs is not installed'))
        assert len(seen.logged('tf2_msgs')) == 1


TORSO = (
    '<mujoco><worldbody><body name="torso"><freejoint/><geom size="0.1"/></body></worldbody>'
    '</mujoco>'
)
BLOCK = TORSO.replace('torso', 'trunk')
BAD_STARTS = {
    'no trunk': ({'robot_model': TORSO}, "must have a body named 'trunk', got torso"),
    'no legs': ({'robot_model': BLOCK, 'motion': 'cmd_vel'}, "motion: 'cmd_vel' needs"),
    'no freedom': (
        {'robot_model': BLOCK.replace('<freejoint/>', ''), 'motion': 'external'},
        "motion: 'external' needs a robot that moves freely",
    ),
    'bad rate': ({'rate': 0.0001}, 'rate: must be .*, got 0.0001'),
    'one name twice': ({'cameras': ['eye', 'eye']}, r"cameras: must be .*\['eye', 'eye'\]"),
    'no name': ({'cameras': ['left eye']}, 'cameras: must be .*left eye'),
    'unknown motion': ({'motion': 'fly'}, "motion: must be one of stand, cmd_vel.*, got 'fly'"),
    'bad pace': ({'real_time_factor': 0.0}, 'real_time_factor: must be a number from .*, got 0.0'),
    'board nowhere': (
        {'scene': 'board', 'board_camera': 'rear'},
        "board_camera: must be .*, got 'rear'",
    ),
}


@pytest.mark.parametrize('case', BAD_STARTS)
def test_an_impossible_start_gives_the_reason(tmp_path, case):
    values, said = BAD_STARTS[case]
    files = {}
    for name, value in values.items():
        if isinstance(value, str) and value.startswith('<'):
            path = tmp_path / f'{name}.xml'
            path.write_text(value)
            files[name] = str(path)
    with pytest.raises(InputError, match=said):
        RobotUnderTest(**{**values, **files})


def test_late_subscribers_get_the_description():
    with robot_node() as seen:
        seen.more(seen.hear('odom', Odometry), 2)
        described = []
        seen.node.create_subscription(
            String,
            f'{seen.space}/robot_description',
            described.append,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )
        seen.spin_until(lambda: described, 'the description')
        shown = ElementTree.fromstring(described[0].data)
        names = {link.get('name') for link in shown.findall('link')}
        assert {'base', 'trunk', 'FR_calf', 'RL_hip'} <= names
        moving = [one for one in shown.findall('joint') if one.get('type') == 'revolute']
        assert {joint.get('name') for joint in moving} == set(JOINTS)


def test_every_frame_has_the_prefix():
    with robot_node(frame_prefix='left/') as seen:
        images = seen.hear('front_left/clean/depth_image', Image)
        poses = seen.hear('odom', Odometry)
        seen.more(images, 1)
        seen.more(poses, 1)
        assert images[0].header.frame_id == 'left/front_left_optical_frame'
        assert (poses[0].header.frame_id, poses[0].child_frame_id) == ('left/odom', 'left/base')
        frames = seen.robot._link_transforms(0, moving=True)
        assert [message.child_frame_id for message in frames] == [
            f'left/{name.removesuffix("_joint")}' for name in JOINTS
        ]
        mounts = tf_frames.camera_transforms('left/base', load_mounts(), 'left/')
        assert all(message.child_frame_id.startswith('left/') for message in mounts)

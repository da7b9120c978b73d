"""Nodes under messages and requests that nobody sends on purpose; the long run is in `bench`."""

import math
import random

from programs import measured
import pytest
from robots import Image, joints, JointState, Odometry, odometry, robot_node, Twist, twist

pytestmark = pytest.mark.usefixtures('ros')

ODD = (0.0, 1.0, -1.0, 1e-300, 1e300, math.nan, math.inf, -math.inf)


def test_a_camera_node_survives_any_message(child_env):
    result = measured('bench.torture_node.run(messages=600, seed=13)', child_env)
    assert result['sent'] == 600
    assert result['answered'] == result['calls'] == 200
    assert result['alive']
    assert result['tracebacks'] == 0


def test_a_walking_robot_survives_any_message():
    rng = random.Random(13)
    with robot_node(motion='cmd_vel') as seen:
        drive, poses = seen.to('cmd_vel', Twist), seen.hear('odom', Odometry)
        for _ in range(100):
            drive.publish(twist(*rng.choices(ODD, k=3)))
            seen.spin_for_a_message()
        drive.publish(twist(0.3))
        assert all(math.isfinite(message.pose.pose.position.x) for message in seen.more(poses, 20))


def test_a_mirroring_robot_survives_any_message():
    rng = random.Random(13)
    names = ('FR_hip_joint', 'FR_hip', 'x' * 3000, '', '\x1b[31m', 'FL_calf_joint')
    with robot_node(motion='external') as seen:
        poses, states = seen.to('odom', Odometry), seen.to('joint_states', JointState)
        images = seen.hear('front_left/clean/depth_image', Image)
        for step in range(100):
            chosen = rng.choices(names, k=rng.randrange(4))
            states.publish(joints(step, rng.choices(ODD, k=len(chosen)), chosen))
            message = odometry(step * 10**8, rng.choices(ODD, k=3), rng.choice(ODD[:5]))
            message.header.stamp.nanosec = rng.choice((0, 2**32 - 1))
            message.child_frame_id = rng.choice(names)
            poses.publish(message)
            seen.spin_for_a_message()
        images.clear()
        for step in range(1, 200):
            poses.publish(odometry(10**18 + step * 10**9, (0.0, 0.0, 0.3)))
            seen.spin_for_a_message()
            if any(image.header.stamp.sec >= 10**9 for image in images):
                break
        else:
            pytest.fail('no image after the hostile messages')
        assert not [text for text in seen.logged('joint_states') if '\x1b' in text]

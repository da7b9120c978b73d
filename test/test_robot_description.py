"""The robot's URDF and its link frames agree with the model that MuJoCo moves."""

from xml.etree import ElementTree

from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.robots.description import BASE, links_of, poses, urdf
from flexx2_sim_ros.robots.model import build_model
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import load_robot
import mujoco
import numpy as np
import pytest

# Anchors away from bodies, several joints on one, references other than 0, and a ball.
ODD = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="root"><freejoint/><geom size="0.1"/>
    <body name="trunk" pos="0.1 0.2 0.3" euler="0.3 0.2 0.1"><geom size="0.1"/>
      <body name="arm" pos="0.2 0 0.1" euler="0.5 0 0.2">
        <joint name="lift" type="slide" axis="0 1 1" pos="0.02 0 0" ref="0.05" range="-1 1"/>
        <joint name="swing" axis="0 1 0" pos="0.05 0.01 0" ref="0.4"/>
        <geom type="capsule" size="0.02 0.1" pos="0 0 0.1" euler="0.7 0 0"/>
        <body name="hand" pos="0 0 0.2"><joint name="wrist" type="ball" pos="0 0 0.01"/>
          <geom type="ellipsoid" size="0.02 0.03 0.04"/>
          <body name="nail" pos="0 0.05 0" euler="0 1.5707963267948966 0"><geom size="0.01"/>
          </body></body></body></body></body>
</worldbody></mujoco>
"""


def frame(position, quaternion):
    """Return (4, 4) of a pose."""
    result, turn = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turn, quaternion)
    result[:3, :3], result[:3, 3] = turn.reshape(3, 3), position
    return result


def from_rpy(text):
    """Return (3, 3) of URDF's rotations about the fixed x, y and z axes."""
    turns = []
    for axis, angle in zip(np.eye(3), map(float, text.split()), strict=True):
        quaternion = np.empty(4)
        mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
        turns.append(frame(np.zeros(3), quaternion)[:3, :3])
    return turns[2] @ turns[1] @ turns[0]


@pytest.fixture(scope='module', params=['builtin', 'odd'])
def model(request, tmp_path_factory):
    """Build Go1, and a robot with everything that is difficult."""
    path = request.param
    if path == 'odd':
        path = tmp_path_factory.mktemp('odd') / 'odd.xml'
        path.write_text(ODD)
    return build_model(str(path), 'corner', intrinsics=flexx2().intrinsics)


def test_joints_without_names_have_those_of_the_description(tmp_path):
    path = tmp_path / 'arm.xml'
    path.write_text("""
        <mujoco><worldbody><body name="trunk"><freejoint/><geom size="0.1"/>
          <body name="arm" pos="0.2 0 0"><joint/><geom size="0.1"/>
            <body pos="0.2 0 0"><joint type="slide"/><geom size="0.1"/></body></body>
        </body></worldbody></mujoco>
        """)
    model = build_model(str(path), intrinsics=flexx2().intrinsics)
    parts = find_parts(model)
    moving = [link.joint for link in links_of(model) if link.moves]
    assert list(parts.joints) == moving
    assert parts.velocities.size == len(moving) == 2
    assert moving[0].startswith('arm_joint_')
    assert len({*parts.joints.values()}) == 2


def test_links_of_the_description_are_at_the_models_bodies(model):
    random, data, robot = np.random.default_rng(3), mujoco.MjData(model), find_parts(model)
    links = links_of(model)
    for _ in range(5):
        data.qpos = random.uniform(-0.8, 0.8, model.nq)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_kinematics(model, data)
        world = {BASE: frame(data.xpos[robot.trunk], data.xquat[robot.trunk])}
        for link, pose in zip(links, poses(links, data.qpos), strict=True):
            world[link.name] = world[link.parent] @ frame(*pose)
            if link.body >= 0:
                body = world[link.name] @ frame(link.shift, np.array([1.0, 0, 0, 0]))
                expected = frame(data.xpos[link.body], data.xquat[link.body])
                np.testing.assert_allclose(body, expected, atol=1e-9)
    assert {model.body(link.body).name for link in links if link.body >= 0} >= {'trunk'}


def test_the_urdf_agrees_with_the_model(model):
    links = links_of(model)
    robot = ElementTree.fromstring(urdf(model, links))
    names = [link.get('name') for link in robot.findall('link')]
    joints = {joint.get('name'): joint for joint in robot.findall('joint')}
    assert names == [BASE, *(link.name for link in links)]
    assert len(set(names)) == len(names)
    assert len(joints) == len(links)
    for link in links:
        joint = joints[link.joint]
        origin = joint.find('origin')
        expected = frame(link.position, link.quaternion)
        np.testing.assert_allclose(from_rpy(origin.get('rpy', '')), expected[:3, :3], atol=1e-7)
        np.testing.assert_allclose(
            [float(value) for value in origin.get('xyz', '').split()], expected[:3, 3], atol=1e-7
        )
        assert [joint.find(tag).get('link') for tag in ('parent', 'child')] == [
            link.parent,
            link.name,
        ]
    mass = sum(float(found.get('value')) for found in robot.iter('mass'))
    carried = sum(model.body_mass[link.body] for link in links if link.body >= 0)
    assert mass == pytest.approx(carried, rel=1e-4)
    assert {shape[0].tag for shape in robot.iter('geometry')} <= {'box', 'cylinder', 'sphere'}


@pytest.mark.parametrize(
    ('name', 'limits'), [('go1', ('-2.818', '-0.888')), ('go2', ('-2.7227', '-0.83776'))]
)
def test_a_robot_has_its_usual_links_and_joints(name, limits):
    kind = load_robot(name)
    model = build_model('builtin', 'corner', intrinsics=flexx2().intrinsics, robot=kind)
    links = links_of(model, kind)
    assert [link.name for link in links] == [
        'trunk',
        *(
            f'{leg}_{part}'
            for leg in ('FR', 'FL', 'RR', 'RL')
            for part in ('hip', 'thigh', 'calf')
        ),
    ]
    robot = ElementTree.fromstring(urdf(model, links))
    knee = next(joint for joint in robot.findall('joint') if joint.get('name') == 'FR_calf_joint')
    limit = knee.find('limit')
    assert knee.get('type') == 'revolute'
    assert (limit.get('lower'), limit.get('upper')) == limits
    assert all(link.find('visual') is not None for link in robot.findall('link')[1:])

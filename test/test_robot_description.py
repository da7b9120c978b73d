"""Robots by their model and by their URDF: links, joints, names, and where models come from."""

import shutil
from xml.etree import ElementTree

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.robots.description import BASE, links_of, poses, urdf
from flexx2_sim_ros.robots.model import build_model, stand
from flexx2_sim_ros.robots.parts import find_parts, plain_name
from flexx2_sim_ros.robots.robot import load_robot
import mujoco
import numpy as np
import pytest

K = flexx2().intrinsics
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
    return build_model(str(path), 'corner', intrinsics=K)


def test_joints_without_names_have_those_of_the_description(tmp_path):
    path = tmp_path / 'arm.xml'
    path.write_text("""
        <mujoco><worldbody><body name="trunk"><freejoint/><geom size="0.1"/>
          <body name="arm" pos="0.2 0 0"><joint/><geom size="0.1"/>
            <body pos="0.2 0 0"><joint type="slide"/><geom size="0.1"/></body></body>
        </body></worldbody></mujoco>
        """)
    model = build_model(str(path), intrinsics=K)
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
        if joint.get('type') == 'revolute':
            limit = joint.find('limit')
            wanted = model.joint(link.joint).range
            found = [float(limit.get(end)) for end in ('lower', 'upper')]
            np.testing.assert_allclose(found, wanted, atol=1e-4)
    mass = sum(float(found.get('value')) for found in robot.iter('mass'))
    carried = sum(model.body_mass[link.body] for link in links if link.body >= 0)
    assert mass == pytest.approx(carried, rel=1e-4)
    assert {shape[0].tag for shape in robot.iter('geometry')} <= {'box', 'cylinder', 'sphere'}


LINK = (
    '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
    'ixz="0" iyz="0"/></inertial>{}</link>'
)
# As Unitree's: a root link without mass, the trunk fixed in it, legs that hang from the trunk.
URDF = (
    '<robot name="r"><link name="base"/>'
    '<joint name="floating_base" type="fixed"><parent link="base"/><child link="trunk"/>'
    '<origin xyz="0.1 0.02 0.05" rpy="0 0 0.3"/></joint>'
    + LINK.format(
        'trunk',
        '<visual><geometry><mesh filename="package://r/trunk.dae"/>'
        '</geometry></visual><collision><geometry><box size="0.3 0.1 0.1"/>'
        '</geometry></collision>',
    )
    + '<joint name="FR_hip_joint" type="revolute"><parent link="trunk"/><child link="FR_hip"/>'
    '<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    '<origin xyz="0.18 -0.04 0"/></joint>'
    + LINK.format(
        'FR_hip',
        '<collision><origin xyz="0 0 -0.2"/><geometry>'
        '<sphere radius="0.05"/></geometry></collision>',
    )
    + '</robot>'
)


@pytest.mark.parametrize(
    ('name', 'plain'),
    [
        ('FR_hip_joint', 'fr_hip'),
        ('FR_hip', 'fr_hip'),
        ('fr_HIP_joint', 'fr_hip'),
        ('go1/RL_calf_joint', 'rl_calf'),
        ('/robots/go1/RL_calf', 'rl_calf'),
        ('FL_0', 'fl_hip'),
        ('RR_1', 'rr_thigh'),
        ('RR_2', 'rr_calf'),
        ('wheel_1', 'wheel_1'),
        ('arm_joint', 'arm'),
    ],
)
def test_a_joint_is_known_by_all_its_names(name, plain):
    assert plain_name(name) == plain


def test_a_urdf_moves_with_its_trunk_where_it_is_put(tmp_path):
    path = tmp_path / 'robot.urdf'
    path.write_text(URDF)
    model = build_model(str(path), 'corner', intrinsics=K)
    data = mujoco.MjData(model)
    stand(model, data)
    lowest = data.body('FR_hip').xpos[2] - 0.25
    assert lowest == pytest.approx(0.0, abs=1e-6)
    robot = find_parts(model)
    assert list(robot.joints) == ['FR_hip_joint']
    assert robot.legs is None
    position, quaternion = np.array([0.3, -0.2, 0.5]), np.array([0.8, 0.2, -0.4, 0.4])
    robot.place(data, position, quaternion)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body('trunk').xpos, position, atol=1e-9)
    np.testing.assert_allclose(data.body('trunk').xquat, quaternion, atol=1e-9)


def test_joints_above_the_trunk_move_it(tmp_path):
    path = tmp_path / 'robot.xml'
    path.write_text("""
        <mujoco><worldbody><body name="pelvis" pos="0 0 0.8"><freejoint/><geom size="0.1"/>
          <body pos="0 0.02 0.1"><joint name="waist" axis="0 0 1"/><geom size="0.1"/>
            <body name="trunk" pos="0.1 0 0.3" euler="10 0 20"><joint name="bow" axis="0 1 0"/>
              <geom size="0.1"/></body></body>
          <body pos="0 0 -0.1"><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.6"/>
          </body></body></worldbody></mujoco>
        """)
    model = build_model(str(path), 'corner', intrinsics=K)
    data, random = mujoco.MjData(model), np.random.default_rng(4)
    robot = find_parts(model)
    angles = random.uniform(-1, 1, 3)
    for name, angle in zip(('waist', 'bow', 'hip'), angles, strict=True):
        data.qpos[robot.joints[name]] = angle
    for _ in range(3):
        position, quaternion = random.uniform(-1, 1, 3), random.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        robot.place(data, position, quaternion)
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.body('trunk').xpos, position, atol=1e-9)
        turn = frame(position, quaternion)[:3, :3]
        np.testing.assert_allclose(data.body('trunk').xmat, turn.ravel(), atol=1e-9)
        kept = [data.qpos[robot.joints[name]] for name in ('waist', 'bow', 'hip')]
        np.testing.assert_array_equal(kept, angles)
    # The twist is how the pose changes when all joints move.
    velocity, seconds = random.uniform(-1, 1, model.nv), 1e-6
    turn = data.body('trunk').xmat.reshape(3, 3).copy()
    linear, angular = robot.twist(data, velocity)
    mujoco.mj_integratePos(model, data.qpos, velocity, seconds)
    mujoco.mj_kinematics(model, data)
    moved = (data.body('trunk').xpos - position) @ turn / seconds
    change = turn.T @ (data.body('trunk').xmat.reshape(3, 3) - turn) / seconds
    np.testing.assert_allclose(linear, moved, atol=1e-4)
    np.testing.assert_allclose(angular, [change[2, 1], change[0, 2], change[1, 0]], atol=1e-4)


@pytest.mark.parametrize(('name', 'radius'), [('go1', '0.02'), ('go2', '0.022')])
def test_menagerie_models_come_from_the_packages_folder(name, radius, tmp_path, monkeypatch):
    pytest.importorskip('mujoco_menagerie')
    folder, robot = tmp_path / f'unitree_{name}', load_robot(name)
    folder.mkdir()
    text = robot.builtin.read_text()
    (folder / f'{name}.xml').write_text(text.replace(f'size="{radius}"', 'size="0.023"'))
    monkeypatch.setenv('MENAGERIE_ROOT', str(tmp_path))
    model = build_model('menagerie', intrinsics=K, robot=robot)
    assert find_parts(model, robot).legs.foot_radius == 0.023
    shutil.rmtree(folder)
    with pytest.raises(InputError, match="robot_model: 'menagerie'.*MENAGERIE_ROOT"):
        build_model('menagerie', intrinsics=K, robot=robot)


def test_an_unreachable_menagerie_is_reported(tmp_path, monkeypatch):
    pytest.importorskip('mujoco_menagerie')
    monkeypatch.delenv('MENAGERIE_ROOT', raising=False)
    monkeypatch.setenv('MENAGERIE_CACHE_DIR', str(tmp_path))
    monkeypatch.setenv('MENAGERIE_BASE_URL', (tmp_path / 'nothing').as_uri())
    with pytest.raises(InputError, match='no unitree_go1 on this machine.*prefetch unitree_go1'):
        build_model('menagerie', intrinsics=K)


def test_a_missing_menagerie_package_is_reported(monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'mujoco_menagerie', None)
    with pytest.raises(InputError, match='pip install mujoco-menagerie, or take builtin'):
        build_model('menagerie', intrinsics=K)

"""The composed model: the robot's figures, the cameras' poses, and what bad files are told."""

from contextlib import closing
import math

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.rendering.scenes import place_board
from flexx2_sim_ros.robots.model import build_model, stand
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import CameraMount, load_mounts, load_robot, robot_names
import mujoco
import numpy as np
import pytest

K = Intrinsics.from_field_of_view(224, 172, 56.0, 44.0)
LEGS = ('FR', 'FL', 'RR', 'RL')
TINY_ROBOT = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 0.5"><freejoint/><geom size="0.05"/></body>
  </worldbody>
</mujoco>
"""


def written(path, text):
    path.write_text(text)
    return str(path)


# Trunk, mass of it and of all; hips, length of a hip; limits and torque of hip, thighs, calf.
FIGURES = {
    'go1': (
        ('trunk', 5.204, 12.743),
        (0.1881, 0.04675, 0.08),
        {
            'hip': (-0.863, 0.863, 23.7),
            'F thigh': (-0.686, 4.501, 23.7),
            'R thigh': (-0.686, 4.501, 23.7),
            'calf': (-2.818, -0.888, 35.55),
        },
    ),
    'go2': (
        ('base', 6.923, 15.019),
        (0.1934, 0.0465, 0.0955),
        {
            'hip': (-1.0472, 1.0472, 23.7),
            'F thigh': (-1.5708, 3.4907, 23.7),
            'R thigh': (-0.5236, 4.5379, 23.7),
            'calf': (-2.7227, -0.83776, 35.55),
        },
    ),
}


@pytest.mark.parametrize('name', FIGURES)
def test_the_robot_has_the_published_figures(name):
    (trunk, mass, total), (front, side, offset), joints = FIGURES[name]
    model = build_model(intrinsics=K, robot=load_robot(name))
    assert model.body(trunk).mass[0] == pytest.approx(mass, abs=1e-6)
    assert model.body_subtreemass[model.body(trunk).id] == pytest.approx(total, abs=1e-3)
    for leg in LEGS:
        x, y = (1 if leg[0] == 'F' else -1), (1 if leg[1] == 'L' else -1)
        np.testing.assert_allclose(model.body(f'{leg}_hip').pos, [front * x, side * y, 0])
        np.testing.assert_allclose(model.body(f'{leg}_thigh').pos, [0, offset * y, 0])
        np.testing.assert_allclose(model.body(f'{leg}_calf').pos, [0, 0, -0.213])
        np.testing.assert_allclose(model.geom(f'{leg}_foot').pos, [0, 0, -0.213])
        for part, axis in (('hip', [1, 0, 0]), ('thigh', [0, 1, 0]), ('calf', [0, 1, 0])):
            low, high, torque = joints.get(f'{leg[0]} {part}') or joints[part]
            joint = model.joint(f'{leg}_{part}_joint')
            np.testing.assert_allclose(joint.axis, axis)
            np.testing.assert_allclose(joint.range, [low, high])
            actuator = model.actuator(f'{leg}_{part}_joint')
            np.testing.assert_allclose(actuator.forcerange, [-torque, torque])
            assert actuator.trnid[0] == joint.id
    home = model.key('home').qpos
    assert home[2] == 0.27
    np.testing.assert_allclose(home[7:], [0, 0.9, -1.8] * 4)


@pytest.mark.parametrize('name', robot_names())
def test_a_robot_does_not_see_itself_and_keeps_standing_when_the_simulation_runs(name):
    robot = load_robot(name)
    model = build_model(intrinsics=K, robot=robot)
    data = mujoco.MjData(model)
    stand(model, data, robot)
    own = np.flatnonzero(find_parts(model, robot).geoms)
    with closing(open_renderer(model, K, 'ray')) as renderer:
        for mount in robot.mounts:
            depth, geom_id = renderer.render(data, mount.name)
            assert not np.isin(geom_id, own).any()
            assert np.isfinite(depth).all()
    mujoco.mj_step(model, data, 500)
    trunk = data.body(robot.trunk)
    assert trunk.xpos[2] > 0.22
    assert trunk.xmat[8] > math.cos(math.radians(5))


def test_the_cameras_sit_where_the_configuration_says():
    model = build_model(intrinsics=K)
    standing = mujoco.MjData(model)
    assert stand(model, standing) == 'home'
    left, right = load_mounts()
    assert (left.name, right.name) == ('front_left', 'front_right')
    assert left.position[1] > 0 > right.position[1]
    for mount in (left, right):
        pose = standing.camera(mount.name)
        place = standing.body('trunk').xpos + mount.position
        np.testing.assert_allclose(pose.xpos, place, atol=1e-9)
        axes = pose.xmat.reshape(3, 3) * [1, -1, -1]  # MuJoCo: y up, z backwards
        np.testing.assert_allclose(axes, mount.rotation, atol=1e-9)
        assert mount.rotation[0, 2] > 0.7  # looks ahead
        assert mount.rotation[2, 2] < 0  # and down
    assert left.rotation[1, 2] > 0 > right.rotation[1, 2]  # and outwards


def test_positive_angles_turn_as_ros_says():
    def axes(*degrees):
        return CameraMount('c', (0, 0, 0), tuple(map(math.radians, degrees))).rotation.T

    right, down, forward = axes(0, 0, 0)
    np.testing.assert_allclose([right, down, forward], [[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    np.testing.assert_allclose(axes(0, 0, 90)[2], [0, 1, 0], atol=1e-12)  # yaw: to the left
    np.testing.assert_allclose(axes(0, 90, 0)[2], [0, 0, -1], atol=1e-12)  # pitch: down
    np.testing.assert_allclose(axes(90, 0, 0)[0], [0, 0, -1], atol=1e-12)  # roll: right ear down
    # Yaw is applied last: the horizon stays level.
    assert axes(0, 20, 30)[0][2] == pytest.approx(0)


def test_a_robot_without_home_or_free_joint_keeps_its_pose(tmp_path):
    robot = written(tmp_path / 'robot.xml', TINY_ROBOT.replace('<freejoint/>', ''))
    model = build_model(robot_model=robot, intrinsics=K)
    data = mujoco.MjData(model)
    assert stand(model, data) == 'qpos0'
    assert data.body('trunk').xpos[2] == 0.5


def test_the_robot_stands_on_whatever_is_below_it(tmp_path):
    scene = written(
        tmp_path / 'scene.xml',
        """
        <mujoco><worldbody>
          <geom type="plane" size="0 0 1" pos="0 0 -0.3"/>
          <geom type="box" size="0.05 0.05 0.2" pos="0 0 -0.2"/>
          <body pos="3 0 1"><freejoint/><geom size="0.1"/></body>
        </worldbody></mujoco>
        """,
    )
    robot = written(tmp_path / 'robot.xml', TINY_ROBOT)
    model = build_model(robot_model=robot, scene=scene, intrinsics=K)
    data = mujoco.MjData(model)
    stand(model, data)
    assert data.body('trunk').xpos[2] == pytest.approx(0.05)
    # The built-in robot's key survives a scene that has joints of its own.
    model = build_model(scene=scene, intrinsics=K)
    data = mujoco.MjData(model)
    assert stand(model, data) == 'home'
    np.testing.assert_allclose(data.qpos[7:19], [0, 0.9, -1.8] * 4)


def test_names_of_the_scene_cannot_clash_with_the_robots(tmp_path):
    scene = written(
        tmp_path / 'scene.xml',
        """
        <mujoco>
          <asset><material name="go1_dark" rgba="1 1 1 1"/></asset>
          <worldbody><body name="trunk"><geom name="trunk_core" size="0.1" material="go1_dark"/>
          </body></worldbody>
        </mujoco>
        """,
    )
    model = build_model(scene=scene, intrinsics=K)
    assert model.body('scene/trunk').id != model.body('trunk').id


BAD_MODELS = {
    'missing file': (None, 'path of an MJCF file'),
    'empty': ('', 'XML'),
    'schema': ('<mujoco><worldbody><geo size="1"/></worldbody></mujoco>', 'geo'),
    'compiler': ('<mujoco><worldbody><geom size="-1"/></worldbody></mujoco>', 'size'),
    'missing mesh': (
        '<mujoco><asset><mesh name="m" file="nothing.stl"/></asset></mujoco>',
        'nothing.stl',
    ),
}


@pytest.mark.parametrize('parameter', ['robot_model', 'scene'])
@pytest.mark.parametrize('case', BAD_MODELS)
def test_a_bad_model_file_is_named(tmp_path, parameter, case):
    text, said = BAD_MODELS[case]
    path = tmp_path / f'{parameter}_bad.xml'
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError) as caught:
        build_model(**{parameter: str(path)}, intrinsics=K)
    message = str(caught.value)
    assert message.startswith(f'{parameter}: ')
    assert str(path) in message
    assert said in message


@pytest.mark.parametrize(
    ('field', 'change'),
    [
        ('intrinsics', {'intrinsics': Intrinsics(224, 172, 210.0, 210.0, 112.0, 86.0)}),
        ('intrinsics', {'intrinsics': Intrinsics(4, 4, 9.0, 9.0, 1.5, 1.5, (0.1, 0, 0, 0, 0))}),
        ('near, far', {'near': 0.0}),
        ('near, far', {'near': 2.0, 'far': 1.0}),
        ('near, far', {'far': math.nan}),
        ('robot_model', {'robot_model': 'go2'}),
        ('scene', {'scene': ''}),
    ],
)
def test_a_bad_argument_is_named(field, change):
    with pytest.raises(InputError, match=f'^{field}: '):
        build_model(**{'intrinsics': K, **change})


GOOD_MOUNT = '{name: a, position: [0, 0, 0], rpy_deg: [0, 0, 0]}'
LOST_MOUNT = '{name: a, position: [0, 0, .nan], rpy_deg: [0, 0, 0]}'


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('cameras: [', 'YAML'),
        ('[]', 'must be a YAML mapping'),
        ('schema: 1', 'cameras'),
        ('{schema: 1, cameras: []}', 'cameras'),
        ('{schema: 1, cameras: [front]}', 'cameras.0.'),
        ('{schema: 1, cameras: [{name: a, position: [0, 0, 0]}]}', 'rpy_deg'),
        ('{schema: 1, cameras: [{name: a, position: [0, 0], rpy_deg: [0, 0, 0]}]}', 'cameras.0.'),
        (f'{{schema: 1, cameras: [{LOST_MOUNT}]}}', 'position'),
        ('{schema: 1, cameras: [{name: 7, position: [0, 0, 0], rpy_deg: [0, 0, 0]}]}', 'name'),
        (f'{{schema: 1, cameras: [{GOOD_MOUNT}, {GOOD_MOUNT}]}}', 'must be unique'),
    ],
)
def test_a_bad_camera_file_is_named(tmp_path, text, said):
    path = tmp_path / 'go1.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_mounts(path)
    assert str(path) in str(caught.value)


GOOD_ROBOT = """
schema: 1
models: {builtin: builtin.xml}
trunk: trunk
cameras: [{name: eye, position: [0.06, 0, 0], rpy_deg: [0, 0, 0]}]
"""


def test_a_robot_is_one_file_and_its_model(tmp_path):
    written(tmp_path / 'builtin.xml', TINY_ROBOT)
    robot = load_robot(written(tmp_path / 'ball.yaml', GOOD_ROBOT))
    assert (robot.name, robot.legs, robot.menagerie) == ('ball', None, '')
    model = build_model(scene='board', intrinsics=K, robot=robot)
    data = mujoco.MjData(model)
    assert stand(model, data, robot) == 'qpos0'
    place_board(model, data, 'eye', 1.0, 0.0)
    assert data.camera('eye').xpos[0] == pytest.approx(0.06)
    with pytest.raises(InputError, match="robot_model: 'menagerie' has no ball"):
        build_model('menagerie', intrinsics=K, robot=robot)


@pytest.mark.parametrize(
    ('good', 'bad', 'said'),
    [
        ('models: {builtin: builtin.xml}', 'models: 7', 'models: must be a mapping, got 7'),
        ('builtin: builtin.xml', 'menagerie: a', 'models: builtin: must be a non-empty text'),
        ('trunk: trunk', 'trunk: [7]', 'trunk: must be a non-empty text'),
        ('trunk: trunk', 'trunk: a\nlegs: {home: 1}', 'legs: must have the fields home, joints'),
        ('cameras:', 'eyes:', 'cameras: must be a list'),
    ],
)
def test_a_bad_robot_file_is_named(tmp_path, good, bad, said):
    path = written(tmp_path / 'ball.yaml', GOOD_ROBOT.replace(good, bad))
    with pytest.raises(InputError, match=said) as caught:
        load_robot(path)
    assert path in str(caught.value)


@pytest.mark.parametrize(
    ('field', 'value', 'said'),
    [
        ('joints', '[[a, b, c]]', 'joints: must be 4 x 3 names'),
        ('home', '[0, 1, .nan]', 'home: must be 3 finite numbers'),
        ('limits', '[[0, 1]]', 'limits: must be 3 pairs'),
        ('limits', '[[0, 1], [0, 1], [0]]', 'limits: must be 2 finite numbers'),
    ],
)
def test_bad_legs_are_named(tmp_path, field, value, said):
    legs = {
        'joints': str([['a', 'b', 'c']] * 4),
        'home': '[0, 0, 0]',
        'limits': '[[0, 1], [0, 1], [0, 1]]',
        field: value,
    }
    text = ', '.join(f'{key}: {given}' for key, given in legs.items())
    with pytest.raises(InputError, match=said):
        load_robot(written(tmp_path / 'r.yaml', GOOD_ROBOT + f'legs: {{{text}}}'))


def test_a_robot_that_is_not_there_is_named():
    with pytest.raises(InputError, match=r'robot: must be go1, go2 or the path .*, got spot'):
        load_robot('spot')

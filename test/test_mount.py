"""The camera to mount, as MJCF and as a macro of xacro."""

import math
from pathlib import Path
import re
from xml.etree import ElementTree

from flexx2_sim_ros.profiles.modes import flexx2
import mujoco
import numpy as np
import pytest

MODELS = Path(__file__).resolve().parents[1] / 'config' / 'models'
ROBOT = """
<mujoco>
  <asset><model name="flexx2" file="{file}"/></asset>
  <worldbody>
    <body name="trunk" pos="0 0 0.4"><geom size="0.05"/>
      <frame pos="0.3 0 0.05" euler="0 20 0">
        <attach model="flexx2" body="flexx2" prefix="a_"/>
      </frame>
    </body>
  </worldbody>
</mujoco>
"""
TRUNK = """<link name="trunk"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def test_a_robot_attaches_the_model():
    model = mujoco.MjModel.from_xml_string(ROBOT.format(file=MODELS / 'flexx2.xml'))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = model.camera('a_depth').id
    pitch = math.radians(20)
    np.testing.assert_allclose(data.cam_xpos[camera], [0.3, 0, 0.45], atol=1e-9)
    # MuJoCo's cameras look along -z, with y up.
    axes = data.cam_xmat[camera].reshape(3, 3)
    np.testing.assert_allclose(-axes[:, 2], [math.cos(pitch), 0, -math.sin(pitch)], atol=1e-9)
    np.testing.assert_allclose(-axes[:, 0], [0, 1, 0], atol=1e-9)
    lens = flexx2().intrinsics
    assert model.cam_resolution[camera].tolist() == [lens.width, lens.height]
    focal, _ = np.split(model.cam_intrinsic[camera], 2)
    pixels = focal / model.cam_sensorsize[camera] * model.cam_resolution[camera]
    np.testing.assert_allclose(pixels, [lens.fx, lens.fy], rtol=1e-6)
    # The housing ends behind the lens, and a ray forward hits nothing of it.
    hit = np.zeros(1, np.int32)
    mujoco.mj_ray(model, data, data.cam_xpos[camera], -axes[:, 2], None, 1, -1, hit)
    assert hit[0] == -1


@pytest.fixture
def urdf(tmp_path, monkeypatch):
    """Return what xacro makes of a robot with the lines that the macro's head gives, twice."""
    xacro = pytest.importorskip('xacro')
    # The package as ROS finds it, for $(find flexx2_sim_ros).
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'flexx2_sim_ros').touch()
    (tmp_path / 'share' / 'flexx2_sim_ros').symlink_to(MODELS.parents[1])
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    head = (MODELS / 'flexx2.urdf.xacro').read_text().partition('-->')[0]
    include, mount = re.findall(r'^ +(<xacro:.*)', head, re.M)
    again = mount.replace('name="front"', 'name="back"')
    (tmp_path / 'robot.xacro').write_text(
        '<robot name="one" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'{include}{TRUNK}{mount}{again}</robot>'
    )
    return str(xacro.process_file(str(tmp_path / 'robot.xacro')).toxml())


def test_the_macro_is_the_same_camera(urdf):
    tree = ElementTree.fromstring(urdf)
    ends = [one.get('link') for one in tree.findall('joint/*') if one.tag in ('parent', 'child')]
    assert ends == [
        end
        for name in ('front', 'back')
        for end in ('trunk', f'{name}_link', f'{name}_link', f'{name}_optical_frame')
    ]
    assert {one.get('type') for one in tree.findall('joint')} == {'fixed'}
    assert tree.find("joint[@name='front_joint']/origin").attrib == {
        'xyz': '0.3 0 0.05',
        'rpy': '0 0.35 0',
    }
    housing = mujoco.MjSpec.from_file(str(MODELS / 'flexx2.xml')).geom('housing')
    sizes = [
        np.array(box.get('size').split(), float)
        for box in tree.findall("link[@name='front_link']//box")
    ]
    assert len(sizes) == 2
    for size in sizes:
        np.testing.assert_allclose(size, 2 * housing.size, atol=1e-12)
    (x, y, z), mass = sizes[0], housing.mass
    inertial = tree.find("link[@name='front_link']/inertial")
    found = inertial.find('inertia')
    wanted = mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(
        [float(found.get(key)) for key in ('ixx', 'iyy', 'izz')], wanted, rtol=1e-4
    )
    mujoco.MjModel.from_xml_string(urdf)  # complains
    joint = tree.find("joint[@name='front_optical_joint']/origin")
    roll, pitch, yaw = map(float, joint.get('rpy', '').split())
    assert pitch == 0
    quat, turned = np.empty(4), np.empty(9)
    mujoco.mju_euler2Quat(quat, [roll, pitch, yaw], 'XYZ')
    mujoco.mju_quat2Mat(turned, quat)
    optical = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # columns: right, down, forward
    np.testing.assert_allclose(turned.reshape(3, 3), optical, atol=1e-9)


def test_robots_of_the_package_have_this_housing():
    robots = pytest.importorskip('flexx2_sim_ros.robots.model')
    housing = mujoco.MjSpec.from_file(str(MODELS / 'flexx2.xml')).geom('housing')
    model = robots.build_model(intrinsics=flexx2().intrinsics)
    np.testing.assert_allclose(model.geom('front_left_housing').size, housing.size)

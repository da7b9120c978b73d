"""What stands in for the vendor's driver: parameters, cloud, frame, and the launch files."""

import re
import shutil
import signal
import subprocess
import sys

from flexx2_sim_ros.nodes.tf_frames import optical_transform
from flexx2_sim_ros.paths import config_dir
import numpy as np
from programs import finish, node_words, PATIENCE, ROOT, started
import pytest
from sensor_msgs.msg import PointCloud2
from streams import (
    array_of,
    boards,
    CameraInfo,
    CLOUD,
    DEPTH,
    FLEXX2,
    Image,
    image_message,
    info_message,
    listening,
    nanoseconds,
    PointField,
    SECOND,
    START,
    stream,
)
import yaml

pytestmark = pytest.mark.usefixtures('ros')

DRIVER = '/pmd_royale_ros_camera_node'
OPTICAL = 'pmd_royale_ros_camera_node_optical_frame'


def test_the_cloud_has_the_drivers_layout_when_asked_for():
    with stream(DEPTH, CLOUD, invalid_value='zero', seed=2) as seen:
        seen.show(boards(), START)
        assert seen.set(cloud_layout='driver').successful
        seen.show(boards(), START + SECOND)
        assert not seen.set(cloud_layout='flat').successful
        plain, driver = seen.messages(CLOUD)
        assert (plain.width, plain.height, plain.row_step) == (224, 172, 224 * 16)
        # As read from the driver's source: its setPointCloud2Fields makes row_step fit the width.
        assert (driver.width, driver.height, driver.row_step) == (172, 224, 172 * 16)
        assert (driver.point_step, driver.is_dense, driver.is_bigendian) == (16, False, False)
        assert [(f.name, f.offset, f.datatype, f.count) for f in driver.fields] == [
            (name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate(('x', 'y', 'z', 'conf'))
        ]
        # The points come in the order of the image's pixels; a pixel without return is all 0.
        points = np.frombuffer(driver.data, '<f4').reshape(172, 224, 4)
        depth = array_of(seen.messages(DEPTH)[1])
        np.testing.assert_array_equal(points[..., 2], depth)
        assert (points[depth == 0] == 0).all()
        assert (depth == 0).any()


def test_the_optical_frame_is_where_the_mount_is():
    # The driver's launch files: x, y, z, w = 0.5, 0.5, -0.5, -0.5 (its negative is the same).
    driver = optical_transform((f'{DRIVER[1:]}_link', OPTICAL), (0, 0, 0), (0, 0, np.pi))
    turn = driver.transform.rotation
    found = np.array([turn.x, turn.y, turn.z, turn.w])
    np.testing.assert_allclose(found * np.sign(found[0]), [0.5, 0.5, -0.5, -0.5], atol=1e-12)
    # Looking 90 degrees down: the optical axis is the parent's -z, image right its -y.
    down = optical_transform(('base_link', 'lens'), (0.1, 0.2, 0.3), (0, np.pi / 2, 0))
    turn, moved = down.transform.rotation, down.transform.translation
    w, v = turn.w, np.array([turn.x, turn.y, turn.z])
    right, _, forward = (
        axis + 2 * np.cross(v, np.cross(v, axis) + w * axis) for axis in np.eye(3)
    )
    np.testing.assert_allclose(forward, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(right, [0, -1, 0], atol=1e-12)
    assert (moved.x, moved.y, moved.z) == (0.1, 0.2, 0.3)


def test_a_parent_names_the_frame():
    with stream(DEPTH, parent_frame='base_link') as seen:
        seen.show(boards(), START, frame_id='of_the_input')
        assert seen.set(frame_id='mine').successful
        seen.show(boards(), START + SECOND, frame_id='of_the_input')
        assert [message.header.frame_id for message in seen.messages(DEPTH)] == [
            'flexx2_camera_optical_frame',
            'mine',
        ]


def _first_cloud(process):
    """Feed the driver's stand-in until it publishes a cloud."""
    with listening() as user:
        image, info = (
            user.node.create_publisher(kind, f'/clean/{topic}', 10)
            for kind, topic in ((Image, 'depth_image'), (CameraInfo, 'camera_info'))
        )
        heard = []
        user.node.create_subscription(PointCloud2, f'{DRIVER}/point_cloud_0', heard.append, 10)
        stamps = iter(range(START, START + 10**6 * SECOND, SECOND))

        def feed():
            assert process.poll() is None
            stamp = next(stamps)
            info.publish(info_message(FLEXX2, stamp))
            image.publish(image_message(boards(), stamp))
            user.spin_for_a_message()
            return bool(heard)

        user.spin_until(feed, 'a cloud')
        return heard[0]


def _check_driver(process):
    cloud = _first_cloud(process)
    assert (cloud.width, cloud.height) == (172, 224)
    assert cloud.header.frame_id == OPTICAL
    assert not np.isnan(np.frombuffer(cloud.data, '<f4')).any()
    finish(process, signal.SIGINT)


def test_the_parameter_file_makes_the_node_the_driver(child_env):
    path = config_dir() / 'flexx2_driver.yaml'
    given = yaml.safe_load(path.read_text())['/**']['ros__parameters']
    assert given['parent_frame'] == f'{DRIVER[1:]}_link'
    words = node_words('flexx2_camera', '--params-file', path, '-r', f'__node:={DRIVER[1:]}')
    with started(words, env=child_env) as process:
        _check_driver(process)


@pytest.fixture
def launch(child_env):
    """Return a function that runs a launch file; skip where there is no launch."""
    reason = (
        'launch_ros is not installed (it is not on the package index): source a ROS 2 '
        'installation, or build launch and launch_ros, to run the launch files'
    )
    pytest.importorskip('launch_ros.actions', reason=reason)

    def run(name, *arguments):
        program = (
            'import sys; from launch import LaunchService; '
            'from launch.actions import IncludeLaunchDescription as Include; '
            'from launch import LaunchDescription as Description; '
            'from launch.launch_description_sources import '
            'PythonLaunchDescriptionSource as Source; '
            'service = LaunchService(); service.include_launch_description('
            'Description([Include(Source(sys.argv[1]), launch_arguments='
            '[tuple(a.split(":=")) for a in sys.argv[2:]])])); sys.exit(service.run())'
        )
        words = [sys.executable, '-c', program, ROOT / 'launch' / name, *arguments]
        return started(words, env=child_env, stderr=subprocess.STDOUT)

    return run


def ended(process, number=None, code=0):
    """End a launch, if it does not by itself, and return what it printed."""
    if number is not None:
        process.send_signal(number)
    output = process.communicate(timeout=PATIENCE)[0]
    assert process.returncode == code, output
    return output


def test_the_drivers_launch_file(launch):
    with launch('flexx2_driver.launch.py') as process:
        _check_driver(process)


@pytest.mark.parametrize('together', ['true', 'false'])
def test_the_robots_launch_file(launch, together):
    words = ['scene:=corner', 'renderer:=ray', 'motion:=stand', 'usecase:=Mode_5_15fps']
    with launch('go1.launch.py', *words, f'one_process:={together}') as process:
        with listening() as user:
            for camera in ('front_left', 'front_right'):
                heard = user.listen(f'/{camera}/flexx2_camera/depth_image_0', Image)
                user.spin_until(lambda heard=heard: heard, f'an image of {camera}')
                assert heard[0].header.frame_id == f'{camera}_optical_frame'
        output = ended(process, signal.SIGINT)
        started = len(re.findall('flexx2_camera-.*process started', output))
        assert started == (1 if together == 'true' else 2)


def test_the_robots_launch_file_starts_the_cameras_of_its_robot(launch, tmp_path):
    mine = (ROOT / 'config' / 'robots' / 'go1.yaml').read_text()
    mine = mine.replace('../models', str(ROOT / 'config' / 'models'))
    (tmp_path / 'mine.yaml').write_text(mine.replace('front_left', 'chin'))
    with launch(
        'go1.launch.py', f'robot:={tmp_path / "mine.yaml"}', 'renderer:=ray', 'motion:=stand'
    ) as process:
        with listening() as user:
            heard = user.listen('/chin/flexx2_camera/depth_image_0', Image)
            user.spin_until(lambda: heard, 'an image of the camera chin')
        ended(process, signal.SIGINT)


def test_arguments_of_the_launch_reach_all_nodes(launch):
    """Assert it of images, their stamps, the names of nodes and their parameters."""
    given = {'effects': 'typical', 'profile': 'kinect_v2', 'usecase': 'depth_30fps'}
    given['use_sim_time'] = False
    more = [f'{name}:={str(value).lower()}' for name, value in given.items()]
    with launch('go1.launch.py', 'renderer:=ray', 'rate:=20', 'namespace:=mine', *more) as process:
        with listening() as user:
            heard = user.listen('/mine/front_left/flexx2_camera/depth_image_0', Image)
            user.spin_until(lambda: len(heard) > 1, 'two images')
            values = user.parameters_of('/mine/front_left/flexx2_camera', *given)
        ended(process, signal.SIGINT)
    first, second = (nanoseconds(message) for message in heard[:2])
    assert (second - first) % (SECOND // 20) == 0
    assert (heard[0].width, heard[0].height) == (512, 424)
    assert values == [*given.values()]


@pytest.mark.parametrize(
    ('argument', 'said'),
    [
        ('use_sim_time:=maybe', 'maybe'),
        ('one_process:=maybe', 'maybe'),
        ('rate:=fast', 'fast'),
        ('robot:=nothing', 'robot: .*nothing'),
        ('usecase:=Mode_1', 'usecase: .*Mode_1'),
        ('scene:=nowhere', 'scene: .*nowhere'),
    ],
)
def test_a_launch_that_fails_ends_with_all_its_nodes(launch, argument, said):
    with launch('go1.launch.py', 'renderer:=ray', 'namespace:=failing', argument) as process:
        output = ended(process, code=1)  # Its pipe closes with the last node.
    assert re.search(said, output)


@pytest.mark.skipif(shutil.which('rviz2') is not None, reason='RViz is installed')
def test_a_launch_without_rviz_starts_nothing(launch):
    with launch('go1.launch.py', 'renderer:=ray', 'namespace:=no_rviz', 'rviz:=true') as process:
        output = ended(process, code=1)  # Its pipe closes with the last node.
    assert 'Caught exception in launch' in output
    assert 'process started' not in output


def test_the_launch_files_are_documented():
    pages = (ROOT / 'docs' / 'nodes.md').read_text()
    for path in (ROOT / 'launch').glob('*.launch.py'):
        assert path.name in pages
        for argument in re.findall(r"^    '(\w+)': \(", path.read_text(), re.M):
            assert f'`{argument}`' in pages

"""What the layouts for RViz and Foxglove show is there, on the graph that the README starts."""

import json

from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
from flexx2_sim_ros.nodes.robot_node import RobotCameras
from flexx2_sim_ros.nodes.tf_frames import camera_transforms
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.robots.robot import load_mounts, load_robot
import pytest
from streams import listening, Parameter
import yaml

CAMERAS = ('front_left', 'front_right')
SPACE = '/layouts'
RVIZ = yaml.safe_load((config_dir() / 'flexx2.rviz').read_text())['Visualization Manager']
FOXGLOVE = json.loads((config_dir() / 'foxglove.json').read_text())
IMAGE, INFO, CLOUD = (f'sensor_msgs/msg/{name}' for name in ('Image', 'CameraInfo', 'PointCloud2'))
ODOMETRY, TWIST = 'nav_msgs/msg/Odometry', 'geometry_msgs/msg/Twist'
FRAMES = {
    'odom',
    'base',
    *(message.child_frame_id for message in camera_transforms('base', load_mounts())),
}


def rviz_topics():
    kinds = {'Image': IMAGE, 'PointCloud2': CLOUD, 'Odometry': ODOMETRY}
    for display in RVIZ['Displays']:
        kind = display['Class'].removeprefix('rviz_default_plugins/')
        if 'Topic' in display:
            yield display['Topic']['Value'], kinds[kind]


def foxglove_topics():
    for name, panel in FOXGLOVE['configById'].items():
        match name.partition('!')[0]:
            case '3D':
                for topic in panel['topics']:
                    yield topic, ODOMETRY if topic == '/odom' else CLOUD
            case 'Image':
                yield panel['imageMode']['imageTopic'], IMAGE
                yield panel['imageMode']['calibrationTopic'], INFO
            case 'Teleop':
                yield panel['topic'], TWIST
            case 'DiagnosticSummary':
                yield panel['topicToRender'], 'diagnostic_msgs/msg/DiagnosticArray'
            case 'Plot':
                for path in panel['paths']:
                    yield path['value'].partition('.')[0], 'sensor_msgs/msg/JointState'


@pytest.fixture(scope='module')
def there(ros):
    """Start the nodes in a namespace of this test's own; return types by topic without it."""
    robot = {'motion': 'cmd_vel', 'scene': 'corner', 'renderer': 'ray'}
    values = [Parameter(name, value=value) for name, value in robot.items()]
    nodes = [RobotCameras(namespace=SPACE, parameter_overrides=values)]
    nodes += [Flexx2Camera(namespace=f'{SPACE}/{camera}') for camera in CAMERAS]
    # The last one to be opened of each node.
    last = {f'/{camera}/flexx2_camera/depth_noise_0' for camera in CAMERAS} | {'/odom', '/cmd_vel'}
    with listening() as user:
        for node in nodes:
            user.add(node)

        def topics():
            found = user.node.get_topic_names_and_types()
            return {topic.removeprefix(SPACE): kinds for topic, kinds in found}

        user.spin_until(lambda: last <= topics().keys(), 'the graph')
        yield topics()
    for node in nodes:
        node.destroy_node()


@pytest.mark.parametrize('topics', [rviz_topics, foxglove_topics])
def test_every_topic_is_there_with_its_type(there, topics):
    wanted = list(topics())
    assert len(wanted) >= 7
    assert [(topic, there.get(topic)) for topic, _ in wanted] == [
        (topic, [kind]) for topic, kind in wanted
    ]
    # Both cameras, clean and simulated.
    for camera in CAMERAS:
        assert {
            f'/{camera}/clean/depth_image',
            f'/{camera}/flexx2_camera/depth_image_0',
            f'/{camera}/flexx2_camera/point_cloud_0',
        } <= {topic for topic, _ in wanted}


def test_every_frame_is_one_of_the_robot():
    tree = next(display for display in RVIZ['Displays'] if display['Class'].endswith('/TF'))
    assert tree['Frames'].keys() - {'All Enabled'} == FRAMES
    assert RVIZ['Global Options']['Fixed Frame'] in FRAMES
    assert RVIZ['Views']['Current']['Target Frame'] in FRAMES
    scene = FOXGLOVE['configById']['3D!robot']
    assert scene['followTf'] in FRAMES
    assert {name.removeprefix('frame:') for name in scene['transforms']} == FRAMES


def test_foxglove_places_every_panel_once():
    def placed(node):
        return [node] if isinstance(node, str) else placed(node['first']) + placed(node['second'])

    assert sorted(placed(FOXGLOVE['layout'])) == sorted(FOXGLOVE['configById'])


def test_foxglove_says_which_joints_it_shows():
    legs = load_robot().legs
    assert legs is not None
    for path in FOXGLOVE['configById']['Plot!joints']['paths']:
        number = int(path['value'].partition('[')[2].removesuffix(']'))
        assert legs.all_names[number] == f'{path["label"].replace(" ", "_")}_joint'


def test_foxglove_drives_within_the_limits():
    teleop = FOXGLOVE['configById']['Teleop!drive']
    # A command holds half a second.
    assert teleop['publishRate'] > 2
    for button, field, most in (
        ('up', 'linear-x', 0.8),
        ('down', 'linear-x', 0.8),
        ('left', 'angular-z', 1.5),
        ('right', 'angular-z', 1.5),
    ):
        assert teleop[f'{button}Button']['field'] == field
        sign = 1 if button in ('up', 'left') else -1
        assert 0 < sign * teleop[f'{button}Button']['value'] <= most

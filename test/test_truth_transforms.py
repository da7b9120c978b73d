"""TF of one robot among several: by the namespaces of the topics, and on one topic."""

import re

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.truth.trajectory import camera_trajectory, PoseSource
from made_bags import header, make, SECOND, write
from made_driver_bags import ROS1
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_types_from_msg

KIND = 'tf2_msgs/msg/TFMessage'
STAMPS = [SECOND + index * SECOND // 30 for index in range(30)]
FRAMES = 'map', 'base'


def transform(parent, child, stamp, x):
    return make(
        'geometry_msgs/msg/TransformStamped',
        header(stamp, parent),
        child,
        make(
            'geometry_msgs/msg/Transform',
            make('geometry_msgs/msg/Vector3', x, 0.0, 0.0),
            make('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 1.0),
        ),
    )


def moving(topic, start, parent='map', late=0):
    """Return a robot that walks 1 m/s along x."""
    return [
        (topic, KIND, stamp, make(KIND, [transform(parent, 'base', stamp + late, start + x)]))
        for stamp, x in zip(STAMPS, np.arange(30) / 30, strict=True)
    ]


def fixed(topic, parent, child, x):
    return topic, KIND, STAMPS[0], make(KIND, [transform(parent, child, 0, x)])


def place(bag, camera='', frames=FRAMES):
    source = PoseSource(frames=frames, clock_offset=0.0)
    return float(camera_trajectory(source, bag, camera).at(np.array([STAMPS[15]]))[0, 0])


@pytest.mark.parametrize(
    ('camera', 'x'), [('robot1/camera', 0.5), ('robot2/camera', 100.5), ('robot2', 100.5)]
)
def test_the_robot_of_the_camera_is_taken(camera, x, tmp_path):
    robots = [*moving('/robot1/tf', 0.0), *moving('/robot2/tf', 100.0)]
    bag = write(tmp_path / 'bag', sorted(robots, key=lambda entry: entry[2]))
    assert place(bag, camera) == pytest.approx(x)


@pytest.mark.parametrize('camera', ['camera', 'robot11/camera', ''])
def test_robots_that_the_camera_does_not_tell_apart_are_refused(camera, tmp_path):
    bag = write(tmp_path / 'bag', [*moving('/robot1/tf', 0.0), *moving('/robot2/tf', 100.0)])
    said = "--tf: must be frames of one robot, got 'map','base', which '/robot1/tf, /robot2/tf'"
    with pytest.raises(InputError, match=re.escape(said)):
        place(bag, camera)


def test_a_chain_does_not_go_through_another_robot(tmp_path):
    """Assert it of a camera whose robot did not publish where its odometry is."""
    bag = write(
        tmp_path / 'bag',
        [
            *moving('/robot1/tf', 0.0, 'odom'),
            fixed('/robot2/tf_static', 'map', 'odom', 100.0),
            *moving('/robot2/tf', 0.0, 'odom'),
        ],
    )
    assert place(bag, 'robot2/camera') == pytest.approx(100.5)
    alone = [*moving('/robot1/tf', 0.0, 'odom'), fixed('/robot2/tf_static', 'map', 'odom', 100.0)]
    with pytest.raises(InputError, match='--tf: must be two frames of'):
        place(write(tmp_path / 'alone', alone), 'robot1/camera')


def test_transforms_around_a_namespace_are_those_of_all_robots(tmp_path):
    robots = [*moving('/robot1/tf', 0.0, 'odom'), *moving('/robot2/tf', 50.0, 'odom')]
    world = fixed('/tf_static', 'map', 'odom', 7.0)
    bag = write(tmp_path / 'bag', [world, *robots])
    assert place(bag, 'robot1/camera') == pytest.approx(7.5)
    assert place(bag, 'robot2/camera') == pytest.approx(57.5)
    # Unless one of them publishes there, too: then it is not known whose odometry the map has.
    mixed = write(tmp_path / 'mixed', [world, *robots, *moving('/tf', 9.0, 'odom')])
    assert place(mixed, 'camera') == pytest.approx(16.5)
    with pytest.raises(InputError, match='--tf: must be two frames of'):
        place(mixed, 'robot1/camera')


@pytest.mark.parametrize('late', [0, SECOND // 60, SECOND // 100])
def test_two_robots_on_one_topic_are_refused(late, tmp_path):
    both = [*moving('/tf', 0.0), *moving('/tf', 2.0, late=late)]
    with pytest.raises(InputError, match='tf of .base.: must be at one place at a time, got'):
        place(write(tmp_path / 'bag', sorted(both, key=lambda entry: entry[2])))
    above = [*moving('/tf', 0.0), *moving('/tf', 2.0, 'world', late)]
    with pytest.raises(InputError, match="--tf: 'base': must have one parent, got 'map, world'"):
        place(write(tmp_path / 'above', above))
    static = [fixed('/tf_static', 'map', 'base', 0.0), fixed('/tf_static', 'map', 'base', 2.0)]
    with pytest.raises(InputError, match='must be at one place at a time, got poses that differ'):
        place(write(tmp_path / 'static', static))


def test_corrections_and_repeats_are_no_second_robot(tmp_path):
    """Assert it of a loop closure, a slow topic, and static transforms that are sent again."""
    robot = moving('/tf', 0.0)
    for entry in robot[20:]:
        entry[3].transforms[0].transform.translation.x += 3.0
    same = fixed('/tf_static', 'base', 'camera', 0.25)
    bag = write(tmp_path / 'bag', [same, *robot, same])
    assert place(bag, frames=('map', 'camera')) == pytest.approx(0.75)
    slow = [
        (topic, kind, stamp + 14 * index * SECOND // 30, message)
        for index, (topic, kind, stamp, message) in enumerate(moving('/tf', 0.0))
    ]
    for index, entry in enumerate(slow):
        entry[3].transforms[0].transform.translation.x = 2.0 * (index % 2)
        stamp = entry[2]
        entry[3].transforms[0].header.stamp.sec = stamp // SECOND
        entry[3].transforms[0].header.stamp.nanosec = stamp % SECOND
    source = PoseSource(frames=FRAMES, clock_offset=0.0)
    found = camera_trajectory(source, write(tmp_path / 'slow', slow))
    assert found.at(np.array([slow[1][2]]))[0, 0] == pytest.approx(2.0)


def test_transforms_of_old_ros_1_are_read(tmp_path):
    """Assert it of tf/tfMessage, which bags up to ROS Hydro have, as those of TUM RGB-D."""
    kind = 'tf/msg/tfMessage'
    if kind not in ROS1.types:
        ROS1.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms\n', kind))
    types, path = ROS1.types, tmp_path / 'old.bag'
    with Writer(path) as writer:
        connection = writer.add_connection('/tf', kind, typestore=ROS1)
        for number, (_, _, stamp, message) in enumerate(moving('/tf', 3.0, '/map')):
            (one,) = message.transforms
            head = types['std_msgs/msg/Header'](
                number, types['builtin_interfaces/msg/Time'](*divmod(stamp, SECOND)), '/map'
            )
            place_of = one.transform.translation
            pose = types['geometry_msgs/msg/Transform'](
                types['geometry_msgs/msg/Vector3'](place_of.x, 0.0, 0.0),
                types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0),
            )
            content = types['geometry_msgs/msg/TransformStamped'](head, '/base', pose)
            writer.write(connection, stamp, ROS1.serialize_ros1(types[kind]([content]), kind))
    assert place(path) == pytest.approx(3.5)

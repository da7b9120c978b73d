"""Rough poses from a bag: odometry, and TF of one robot, also among several."""

from dataclasses import replace
import re

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.trajectory import camera_trajectory, PoseSource
from made_bags import header, image, info, make, SECOND, usecase, write
from made_driver_bags import ROS1
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_types_from_msg
from scans import bodies, errors, IN_BODY, MOUNT, record, refused, rough, text, truth
from scipy.spatial.transform import Rotation

KIND = 'tf2_msgs/msg/TFMessage'
STAMPS = [SECOND + index * SECOND // 30 for index in range(30)]
FRAMES = 'map', 'base'
# Of a pose that is recorded: metres along and radians about the axes of the room.
DEVIATIONS = np.array([0.001, 0.004, 0.002, 0.003, 0.001, 0.005])


def transform(parent, child, stamp, pose):
    """Return one transform of TF."""
    x, y, z, *turn = pose.numbers()
    return make(
        'geometry_msgs/msg/TransformStamped',
        header(stamp, parent),
        child,
        make(
            'geometry_msgs/msg/Transform',
            make('geometry_msgs/msg/Vector3', x, y, z),
            make('geometry_msgs/msg/Quaternion', *turn),
        ),
    )


def along(x):
    return Pose(np.eye(3), np.array([x, 0.0, 0.0]))


def tf(topic, stamp, *transforms):
    return topic, KIND, stamp, make(KIND, list(transforms))


def moving(topic, start, parent='map', late=0):
    """Return a robot that walks 1 m/s along x."""
    return [
        tf(topic, stamp, transform(parent, 'base', stamp + late, along(start + x)))
        for stamp, x in zip(STAMPS, np.arange(30) / 30, strict=True)
    ]


def fixed(topic, parent, child, x):
    return tf(topic, STAMPS[0], transform(parent, child, 0, along(x)))


def odometry(stamp, pose, covariance=None):
    """Return odometry without its velocities, or a pose with a (6, 6) covariance."""
    x, y, z, *turn = pose.numbers()
    place = make(
        'geometry_msgs/msg/PoseWithCovariance',
        make(
            'geometry_msgs/msg/Pose',
            make('geometry_msgs/msg/Point', x, y, z),
            make('geometry_msgs/msg/Quaternion', *turn),
        ),
        np.zeros(36) if covariance is None else covariance.ravel(),
    )
    if covariance is not None:
        kind = 'geometry_msgs/msg/PoseWithCovarianceStamped'
        return '/pose', kind, stamp, make(kind, header(stamp, 'odom'), place)
    kind, zero = 'nav_msgs/msg/Odometry', make('geometry_msgs/msg/Vector3', 0.0, 0.0, 0.0)
    speed = make('geometry_msgs/msg/Twist', zero, zero)
    speed = make('geometry_msgs/msg/TwistWithCovariance', speed, np.zeros(36))
    return '/odom', kind, stamp, make(kind, header(stamp, 'odom'), 'base', place, speed)


@pytest.fixture(scope='module')
def walk(tmp_path_factory):
    """Return a folder with `in/0.npz` and `room.ply`, the camera, and stamps in nanoseconds."""
    folder = tmp_path_factory.mktemp('walk')
    camera = record(folder, {}, recordings=1, moving=True)
    return folder, camera, open_recording(folder / 'in' / '0.npz').stamp_ns.tolist()


@pytest.fixture(scope='module')
def driver_messages(walk):
    """Return what the driver publishes during the walk."""
    folder, _, stamps = walk
    recording = open_recording(folder / 'in' / '0.npz').load()
    node = '/pmd_royale_ros_camera_node'
    entries = [usecase(node, stamps[0], 'Mode_9_30fps')]
    for stamp, depth in zip(stamps, recording.depth, strict=True):
        entries += [
            image(f'{node}/depth_image_0', stamp, np.nan_to_num(depth)),
            info(f'{node}/camera_info', stamp, depth.shape, recording.K, np.zeros(5)),
        ]
    return entries


@pytest.fixture(scope='module')
def bag(tmp_path_factory, walk, driver_messages):
    """Return a bag of the walk with odometry and TF; odometry begins at its own origin."""
    _, camera, stamps = walk
    told = bodies(camera)
    first = told[0]
    static = [transform('map', 'odom', 0, first), transform('base', 'optical', 0, MOUNT)]
    entries = [*driver_messages, tf('/tf_static', stamps[0], *static)]
    for stamp, pose in zip(stamps, told, strict=True):
        own = Pose(first.R.T @ pose.R, first.R.T @ (pose.t - first.t))
        entries += [tf('/tf', stamp, transform('odom', 'base', stamp, own)), odometry(stamp, own)]
    return write(tmp_path_factory.mktemp('bag') / '0', entries)


def test_poses_come_from_odometry_and_from_transforms(bag, walk):
    _, camera, stamps = walk
    stamps = np.array(stamps)
    tf = camera_trajectory(PoseSource(frames=('map', 'optical')), bag).at(stamps)
    for numbers, pose in zip(tf, camera.poses(0), strict=True):
        assert np.abs(Pose(*pose).motion_to(Pose.from_numbers(numbers))).max() < 1e-6
    mount = tuple(MOUNT.numbers())
    odom = camera_trajectory(PoseSource(topic='/odom', camera_in_body=mount), bag).at(stamps)
    moved, there = (
        Pose.from_numbers(poses[0]).motion_to(Pose.from_numbers(poses[-1])) for poses in (odom, tf)
    )
    assert moved == pytest.approx(there, abs=1e-6)
    # Between two stamps it is between two poses; after the last there is none.
    between = camera_trajectory(PoseSource(frames=('map', 'optical')), bag).at(stamps + 1_000_000)
    assert np.isnan(between[-1]).all()
    assert np.abs(between[:-1, :3] - tf[:-1, :3]).max() < 0.005


def test_a_camera_whose_transforms_are_all_static_starts_there(tmp_path, walk, driver_messages):
    """Assert that a tripod's pose on /tf_static is enough, although the camera moves a little."""
    folder, camera, stamps = walk
    start = rough(camera.poses(0)[0], np.random.default_rng(4))
    static = tf('/tf_static', stamps[0], transform('map', 'optical', 0, start))
    options = '--scan', folder / 'room.ply', '--tf', 'map,optical'
    table = truth(tmp_path / 'out', write(tmp_path / '0', [*driver_messages, static]), *options)
    assert table['clock_offset']['reason'] == 'the given poses do not move'
    assert errors(tmp_path / 'out', camera).max() < 0.01


def test_odometry_of_its_own_frame_gives_the_motion(tmp_path, bag, walk):
    folder, camera, _ = walk
    start = rough(camera.poses(0)[0], np.random.default_rng(4))
    options = '--odometry', '/odom', '--relative', IN_BODY, f'--pose={text(start)}'
    truth(tmp_path / 'out', bag, '--scan', folder / 'room.ply', *options)
    assert errors(tmp_path / 'out', camera).max() < 0.01


def motions_of_the_camera(body, rng):
    """Return (6, 6) covariance of the camera's motions while its body is off, by many draws."""
    moves = []
    camera = Pose(body.R @ MOUNT.R, body.t + body.R @ MOUNT.t)
    for error in rng.normal(0, DEVIATIONS, (1000, 6)):
        turn = Rotation.from_rotvec(error[3:]).as_matrix() @ body.R  # axes of the room
        place = body.t + error[:3]
        moves.append(camera.motion_to(Pose(turn @ MOUNT.R, place + turn @ MOUNT.t)))
    return np.cov(np.array(moves).T)


def test_poses_say_how_accurate_they_are(tmp_path, walk, driver_messages):
    """Assert it for columns of a file and for messages, by draws of errors of the body."""
    folder, camera, stamps = walk
    told = bodies(camera)
    poses = [pose.numbers() for pose in told]
    deviations = np.tile(np.roll(DEVIATIONS, 3), (len(told), 1))
    rows = np.column_stack([np.array(stamps) / 1e9, poses, deviations])
    head, mocap = 'time,x,y,z,qx,qy,qz,qw,srx,sry,srz,sx,sy,sz', tmp_path / 'mocap.csv'
    np.savetxt(mocap, rows, '%.9f', ',', header=head, comments='')
    covariance = np.diag(DEVIATIONS**2)
    entries = [odometry(*one, covariance) for one in zip(stamps, told, strict=True)]
    bag = write(tmp_path / '0', [*driver_messages, *entries])
    rng = np.random.default_rng(1)
    drawn = np.mean([motions_of_the_camera(pose, rng) for pose in told], axis=0)
    size = np.sqrt(np.diag(drawn))
    given = '--scan', folder / 'room.ply', '--clock-offset', 0, IN_BODY
    file = folder / 'in', '--trajectory', mocap
    topic = bag, '--odometry', '/pose', '--pose-accuracy', 'recorded'
    for name, words in (('file', file), ('topic', topic)):
        (row,) = truth(tmp_path / name, *words, *given)['recordings']
        assert row['verdict'] == 'used'
        assert 'told_off_mm' not in row  # They are not fitted.
        with np.load(tmp_path / name / '0.npz') as archive:
            covariance = archive['pose_covariance']
        # A chance below 1e-6: 5.7 standard deviations of a variance of 8 times 1000 draws.
        assert np.abs((covariance - drawn) / np.outer(size, size)).max() < 0.09
    both = truth(tmp_path / 'both', *file, *given, '--pose-accuracy=1e-3,1')
    assert both['recordings'][0]['pose_sigma_mm'] == 1.0  # What a person says counts more.


def test_odometry_without_a_covariance_has_no_accuracy(bag, walk, tmp_path):
    source = PoseSource(topic='/odom', recorded=True)
    with pytest.raises(InputError, match='must have variances of all six axes, above 0'):
        camera_trajectory(source, bag)
    wrong = np.diag(DEVIATIONS**2)
    wrong[0, 1] = wrong[1, 0] = 1.1 * DEVIATIONS[0] * DEVIATIONS[1]
    entries = [odometry(stamp, along(0.0), wrong) for stamp in walk[2]]
    with pytest.raises(InputError, match='correlations of at most 1'):
        camera_trajectory(replace(source, topic='/pose'), write(tmp_path / '0', entries))


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (('--odometry', '/no'), "one of '/odom', got '/no'"),
        (('--tf', 'map,nowhere'), 'must be two frames'),
        (('--tf', 'world,optical'), "it has 'base, map, odom, optical'"),
    ],
)
def test_a_bag_without_these_poses_is_one_sentence(tmp_path, bag, walk, options, words, capsys):
    scan = '--scan', walk[0] / 'room.ply'
    assert words in refused(capsys, tmp_path / 'out', bag, *scan, *options)


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
    stamps = [SECOND + index * SECOND // 2 for index in range(30)]
    slow = [
        tf('/tf', stamp, transform('map', 'base', stamp, along(2.0 * (index % 2))))
        for index, stamp in enumerate(stamps)
    ]
    source = PoseSource(frames=FRAMES, clock_offset=0.0)
    found = camera_trajectory(source, write(tmp_path / 'slow', slow))
    assert found.at(np.array([stamps[1]]))[0, 0] == pytest.approx(2.0)


def test_transforms_of_old_ros_1_are_read(tmp_path):
    """Assert it of tf/tfMessage, which bags up to ROS Hydro have, as those of TUM RGB-D."""
    kind = 'tf/msg/tfMessage'
    if kind not in ROS1.types:
        ROS1.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms\n', kind))
    types, path = ROS1.types, tmp_path / 'old.bag'
    with Writer(path) as writer:
        connection = writer.add_connection('/tf', kind, typestore=ROS1)
        for number, (_, _, stamp, message) in enumerate(moving('/tf', 3.0)):
            (one,) = message.transforms
            head = types['std_msgs/msg/Header'](number, one.header.stamp, '/map')
            one.header, one.child_frame_id = head, '/base'
            content = types[kind]([one])
            writer.write(connection, stamp, ROS1.serialize_ros1(content, kind))
    assert place(path) == pytest.approx(3.5)

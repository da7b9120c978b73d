"""Rough poses for ground truth from a scan: motion capture, odometry and TF, with errors."""

from dataclasses import replace

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.trajectory import (
    camera_trajectory,
    IDENTITY,
    PoseSource,
    read_trajectory,
)
from made_bags import header, image, info, make, SECOND, usecase, write
import numpy as np
import pytest
from scans import box, SMALL_K
from scipy.spatial.transform import Rotation
from study.blind.meshes import mesh_pose, write_mesh
from study.blind.rooms import Path as Walk
from study.blind.scanned import off, ScannedCamera
import yaml

WIDTH, HEIGHT, FRAMES = 112, 86, 8
CLOCK = 1_700_000_000 * SECOND  # what motion capture calls the recording's time 0
# The camera in the body that motion capture follows.
MOUNT = Pose.from_numbers(np.array([0.08, -0.02, 0.05, 0.3, -0.5, 0.4, 0.7]))
HEAD = 't,x,y,z,qx,qy,qz,qw'


def text(numbers):
    """Return numbers of a pose as an option has them."""
    return ','.join(map(repr, map(float, numbers)))


@pytest.fixture(scope='module')
def walk(tmp_path_factory):
    """Return a folder with `in/0.npz` and `room.ply`, the camera, and stamps in nanoseconds."""
    folder = tmp_path_factory.mktemp('walk')
    camera = ScannedCamera(2, {}, 1, FRAMES, WIDTH, HEIGHT, moving=True)
    (folder / 'in').mkdir()
    camera.record(folder / 'in')
    write_mesh(camera.solids, folder / 'room.ply')
    return folder, camera, open_recording(folder / 'in' / '0.npz').stamp_ns


def bodies(camera, wrong=True):
    """Return where the body was in each frame, 5 cm and 3 degrees wrong."""
    poses = []
    for pose in camera.poses(0):
        R, t = off(pose, 0.05, 3.0, np.random.default_rng(3)) if wrong else pose
        turn = R @ MOUNT.R.T
        poses.append(Pose(turn, t - turn @ MOUNT.t))
    return poses


def errors(campaign, camera):
    """Return each frame's median error of clean depth, metres."""
    written = open_recording(campaign / '0.npz').load()
    assert written.clean_depth is not None
    told = camera.camera.scenes.clean(0)[0]
    return np.asarray(np.nanmedian(np.abs(written.clean_depth - told), axis=(1, 2)))


def truth(folder, recording, out, *options):
    scan = str(folder / 'room.ply')
    command = ['gap', 'truth', str(recording), '--scan', scan, '--out', str(out), '--jobs', '1']
    assert main([*command, *options]) == 0
    return dict(yaml.safe_load((out / 'truth.yaml').read_text()))


def test_motion_capture_starts_a_walk_though_it_is_wrong(tmp_path, walk):
    """A marker 5 cm and 3 degrees off, and a clock that is 30 ms late besides."""
    folder, camera, stamps = walk
    lines = ['frame,qw,qx,qy,qz,x,y,z,time']
    for i, (stamp, pose) in enumerate(zip(stamps, bodies(camera), strict=True)):
        x, y, z, qx, qy, qz, qw = pose.numbers()
        when = CLOCK + int(stamp) + SECOND * 3 // 100
        lines.append(f'{i},{qw},{qx},{qy},{qz},{x},{y},{z},{when // SECOND}.{when % SECOND:09d}')
    lines.insert(3, '7,,,,,,,,')  # the marker was hidden
    # Before and after, so that the late clock has poses too.
    for place, shift in ((1, -1), (len(lines) + 1, 1)):
        words = lines[place if shift < 0 else place - 2].split(',')
        lines.insert(place, ','.join([*words[:-1], f'{float(words[-1]) + 0.1 * shift:.6f}']))
    path = tmp_path / 'vicon.csv'
    path.write_text('\n'.join(lines))
    options = ['--trajectory', str(path), f'--camera-in-body={text(MOUNT.numbers())}']
    late = f'--clock-offset=-{CLOCK // SECOND}'
    table = truth(folder, folder / 'in', tmp_path / 'out', *options, late)
    assert errors(tmp_path / 'out', camera).max() < 0.01
    row = table['recordings'][0]
    assert 30 < row['told_off_mm'] < 80
    assert 2 < row['told_off_deg'] < 4.5


@pytest.mark.parametrize(('off_by', 'moves'), [(0.0, 0.0), (0.0, 0.1), (0.45, 0.0)])
def test_given_poses_tell_the_motion_and_are_never_left(tmp_path, capsys, off_by, moves):
    pose, depth = box(tmp_path)
    x, *others = map(float, pose.split(','))
    seen = depth + np.random.default_rng(1).normal(0, 0.002, (8, *depth.shape))
    file, stamp = tmp_path / 'r.npz', np.arange(8) / 30
    np.savez(file, depth=seen.astype(np.float32), K=SMALL_K, stamp=stamp)
    lines = [[t, x + off_by + moves * (t > 0.1), *others] for t in stamp]
    path = tmp_path / 'vicon.txt'
    path.write_text('\n'.join(' '.join(map(str, line)) for line in lines))
    scan = ['--scan', str(tmp_path / 'room.ply'), '--jobs', '1', '--out', str(tmp_path / 'out')]
    command = ['gap', 'truth', str(file), *scan, '--trajectory', str(path), '--clock-offset', '0']
    assert main(command) == (2 if off_by else 0)
    if off_by:
        assert 'degrees from the given one' in ' '.join(capsys.readouterr().err.split())
        assert not (tmp_path / 'out').exists()
    else:
        row = yaml.safe_load((tmp_path / 'out' / 'truth.yaml').read_text())['recordings'][0]
        assert row['motion'] == ('moving' if moves else 'still')


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (['--pose-accuracy', '0.002,0.2'], ''),
        (['--pose-accuracy', '0.002,0.2', '--clock-offset', 'auto'], 'and --clock-offset SECONDS'),
        (['--pose-accuracy', '2'], 'must be METRES,DEGREES'),
        (['--pose-accuracy', '0,0.2'], 'must be METRES,DEGREES'),
    ],
)
def test_poses_of_a_known_accuracy_are_used_as_they_are(tmp_path, capsys, options, words):
    """Assert it for a camera that shows another pose, and a folder of trajectories."""
    pose, depth = box(tmp_path)
    x, *others = map(float, pose.split(','))
    file, stamp = tmp_path / 'r.npz', np.arange(8) * 0.033
    np.savez(file, depth=np.tile(depth, (8, 1, 1)), K=SMALL_K, stamp=stamp)
    (tmp_path / 'poses').mkdir()
    lines = [[t, x + 0.02 + 0.5 * t, *others] for t in stamp[:-2]]
    (tmp_path / 'poses' / 'r.txt').write_text('\n'.join(' '.join(map(str, n)) for n in lines))
    scan = ['--scan', str(tmp_path / 'room.ply'), '--jobs', '1', '--out', str(tmp_path / 'out')]
    command = ['gap', 'truth', str(file), *scan, '--trajectory', str(tmp_path / 'poses')]
    command += ['--clock-offset', '0', *options]
    assert main(command) == (2 if words else 0)
    assert words in ' '.join(capsys.readouterr().err.split())
    if not words:
        row = yaml.safe_load((tmp_path / 'out' / 'truth.yaml').read_text())['recordings'][0]
        assert (row['motion'], row['pose_sigma_mm']) == ('moving', 2.0)
        assert row['pose'][0] == pytest.approx(x + 0.02)
        written = open_recording(tmp_path / 'out' / 'r.npz').load()
        known = written.extra['known'].mean(axis=(1, 2))
        # There is no pose for the last two frames, and the others are not those of the images.
        assert (known > 0.9).tolist() == [True] * 6 + [False] * 2
        assert np.abs(written.clean_depth[5] - depth).max() > 0.05


@pytest.mark.parametrize('wrong', [False, True])
def test_a_camera_that_is_mounted_otherwise_than_told_is_doubtful(tmp_path, walk, wrong):
    """Assert it for poses of motion capture: a mount that is off looks like errors of depth."""
    folder, camera, stamps = walk
    path = tmp_path / 'vicon.txt'
    pairs = zip(stamps, bodies(camera, wrong=False), strict=True)
    rows = [[stamp / 1e9, *pose.numbers()] for stamp, pose in pairs]
    path.write_text('\n'.join(' '.join(map(repr, map(float, row))) for row in rows))
    motion = np.array([0.03, -0.01, 0.02, 0.0, np.radians(2), 0.0])
    told = MOUNT.moved(motion) if wrong else MOUNT
    options = ['--trajectory', str(path), f'--camera-in-body={text(told.numbers())}']
    options += ['--clock-offset', '0', '--pose-accuracy', '0.002,0.2']
    table = truth(folder, folder / 'in', tmp_path / 'out', *options)
    (row,) = table['recordings']
    assert row['verdict'] == ('doubtful' if wrong else 'used')
    if wrong:
        said = next(reason for reason in row['reasons'] if 'measure --camera-in-body' in reason)
        shown = said.partition('show: ')[2].strip(')')
        off_by = MOUNT.motion_to(Pose.from_numbers(np.array(shown.split(','), float)))
        assert np.abs(off_by[:3]).max() < 0.005
        assert np.abs(off_by[3:]).max() < np.radians(0.3)


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


def odometry(stamp, pose, covariance=None):
    """Return odometry without its velocities, and a pose with the (6, 6) covariance if any."""
    x, y, z, *turn = pose.numbers()
    told = np.zeros(36) if covariance is None else covariance
    kind, zero = 'nav_msgs/msg/Odometry', make('geometry_msgs/msg/Vector3', 0.0, 0.0, 0.0)
    place = make(
        'geometry_msgs/msg/Pose',
        make('geometry_msgs/msg/Point', x, y, z),
        make('geometry_msgs/msg/Quaternion', *turn),
    )
    message = make(
        kind,
        header(stamp, 'odom'),
        'base',
        make('geometry_msgs/msg/PoseWithCovariance', place, np.ravel(told)),
        make(
            'geometry_msgs/msg/TwistWithCovariance',
            make('geometry_msgs/msg/Twist', zero, zero),
            np.zeros(36),
        ),
    )
    if covariance is not None:
        kind = 'geometry_msgs/msg/PoseWithCovarianceStamped'
        return '/pose', kind, stamp, make(kind, message.header, message.pose)
    return '/odom', kind, stamp, message


def driver_messages(walk):
    """Return what the driver publishes during the walk."""
    folder, _, stamps = walk
    recording = open_recording(folder / 'in' / '0.npz').load()
    node = '/pmd_royale_ros_camera_node'
    entries = [usecase(node, int(stamps[0]), 'Mode_9_30fps')]
    for stamp, depth in zip(map(int, stamps), recording.depth, strict=True):
        entries += [
            image(f'{node}/depth_image_0', stamp, np.nan_to_num(depth)),
            info(f'{node}/camera_info', stamp, depth.shape, recording.K, np.zeros(5)),
        ]
    return entries


@pytest.fixture(scope='module')
def bag(tmp_path_factory, walk):
    """Return a bag of the walk with odometry and TF; odometry begins at its own origin."""
    _, camera, stamps = walk
    told = bodies(camera, wrong=False)
    first = told[0]
    kind = 'tf2_msgs/msg/TFMessage'
    fixed = [transform('map', 'odom', 0, first), transform('base', 'optical', 0, MOUNT)]
    entries = [*driver_messages(walk), ('/tf_static', kind, int(stamps[0]), make(kind, fixed))]
    for stamp, pose in zip(map(int, stamps), told, strict=True):
        # The frame of odometry is where the body was at first.
        own = Pose(first.R.T @ pose.R, first.R.T @ (pose.t - first.t))
        entries += [
            ('/tf', kind, stamp, make(kind, [transform('odom', 'base', stamp, own)])),
            odometry(stamp, own),
        ]
    return write(tmp_path_factory.mktemp('bag') / '0', entries)


def test_poses_come_from_odometry_and_from_transforms(bag, walk):
    _, camera, stamps = walk
    tf = camera_trajectory(PoseSource(frames=('map', 'optical')), bag).at(stamps)
    for numbers, pose in zip(tf, camera.poses(0), strict=True):
        assert np.abs(Pose(*pose).motion_to(Pose.from_numbers(numbers))).max() < 1e-6
    mount = tuple(MOUNT.numbers())
    odom = camera_trajectory(PoseSource(topic='/odom', camera_in_body=mount), bag).at(stamps)
    moved, there = (
        Pose.from_numbers(poses[0]).motion_to(Pose.from_numbers(poses[-1])) for poses in (odom, tf)
    )
    assert moved == pytest.approx(there, abs=1e-6)
    # Between two stamps it is between two poses; before the first there is none.
    between = camera_trajectory(PoseSource(frames=('map', 'optical')), bag).at(stamps + 1_000_000)
    assert np.isnan(between[-1]).all()
    assert np.abs(between[:-1, :3] - tf[:-1, :3]).max() < 0.005


DEVIATIONS = np.array([0.001, 0.004, 0.002, 0.003, 0.001, 0.005])


def motions_of_the_camera(body, rng):
    """Return (6, 6) covariance of the camera's motions while its body is off, by many draws."""
    right, moves = body.moved(np.zeros(6)), []
    camera = Pose(right.R @ MOUNT.R, right.t + right.R @ MOUNT.t)
    for error in rng.normal(0, DEVIATIONS, (1000, 6)):
        turn = Rotation.from_rotvec(error[3:]).as_matrix() @ body.R  # axes of the room
        place = body.t + error[:3]
        moves.append(camera.motion_to(Pose(turn @ MOUNT.R, place + turn @ MOUNT.t)))
    return np.cov(np.array(moves).T)


def test_poses_say_how_accurate_they_are(tmp_path, walk):
    """Assert it for columns of a file and for messages, by draws of errors of the body."""
    folder, camera, stamps = walk
    told = bodies(camera, wrong=False)
    lines = ['time,' + HEAD.partition(',')[2] + ',srx,sry,srz,sx,sy,sz']
    for stamp, pose in zip(stamps, told, strict=True):
        numbers = [*pose.numbers(), *np.roll(DEVIATIONS, 3)]
        lines.append(f'{stamp / 1e9:.9f},{text(numbers)}')
    (tmp_path / 'mocap.csv').write_text('\n'.join(lines))
    entries = [
        odometry(int(stamp), pose, np.diag(DEVIATIONS**2))
        for stamp, pose in zip(stamps, told, strict=True)
    ]
    bag = write(tmp_path / '0', [*driver_messages(walk), *entries])
    rng = np.random.default_rng(1)
    drawn = np.mean([motions_of_the_camera(pose, rng) for pose in told], axis=0)
    size = np.sqrt(np.diag(drawn))
    given = ['--clock-offset', '0', f'--camera-in-body={text(MOUNT.numbers())}']
    file = ['--trajectory', str(tmp_path / 'mocap.csv')]
    for name, recording, options in (
        ('file', folder / 'in', file),
        ('topic', bag, ['--odometry', '/pose', '--pose-accuracy', 'recorded']),
    ):
        table = truth(folder, recording, tmp_path / name, *options, *given)
        (row,) = table['recordings']
        assert row['verdict'] == 'used'
        assert 'told_off_mm' not in row  # They are not fitted.
        with np.load(tmp_path / name / '0.npz') as archive:
            covariance = archive['pose_covariance']
        # A chance below 1e-6: 5.7 standard deviations of a variance of 8 times 1000 draws.
        assert np.abs((covariance - drawn) / np.outer(size, size)).max() < 0.09
    both = truth(folder, folder / 'in', tmp_path / 'both', *file, *given, '--pose-accuracy=1e-3,1')
    assert both['recordings'][0]['pose_sigma_mm'] == 1.0  # What a person says counts more.


@pytest.mark.parametrize(
    ('columns', 'options', 'words'),
    [
        (',sx,sy', ['--clock-offset', '0'], 'must have all of the columns sx, sy, sz'),
        (',sx,sy,sz,srx,sry,srz', [], 'sry, srz: must be given with poses in the room and'),
        (',sx,sy,sz,srx,sry,srz', ['--clock-offset', '0', '--relative'], 'poses in the room and'),
        ('', ['--pose-accuracy', 'recorded'], 'must be METRES,DEGREES without --odometry'),
    ],
)
def test_an_accuracy_that_cannot_be_used_is_one_sentence(
    tmp_path, walk, capsys, columns, options, words
):
    path, count = tmp_path / 'mocap.csv', columns.count(',')
    first, *_, last = walk[2] / 1e9
    rows = (f'{when},1,2,3,0,0,0,1' + ',0.001' * count for when in (first - 0.1, last + 0.1))
    path.write_text('\n'.join([HEAD + columns, *rows]))
    command = ['gap', 'truth', str(walk[0] / 'in'), '--scan', str(walk[0] / 'room.ply')]
    command += ['--trajectory', str(path), '--out', str(tmp_path / 'out'), '--jobs', '1']
    assert main([*command, *options]) == 2
    assert words in ' '.join(capsys.readouterr().err.split())


def test_odometry_without_a_covariance_has_no_accuracy(bag, walk, tmp_path):
    source = PoseSource(topic='/odom', recorded=True)
    with pytest.raises(InputError, match='must have variances of all six axes, above 0'):
        camera_trajectory(source, bag)
    wrong = np.diag(DEVIATIONS**2)
    wrong[0, 1] = wrong[1, 0] = 1.1 * DEVIATIONS[0] * DEVIATIONS[1]
    entries = [odometry(int(stamp), Pose(np.eye(3), np.zeros(3)), wrong) for stamp in walk[2]]
    with pytest.raises(InputError, match='correlations of at most 1'):
        camera_trajectory(replace(source, topic='/pose'), write(tmp_path / '0', entries))


def test_a_camera_whose_transforms_are_all_static_starts_there(tmp_path, walk):
    """Assert that a tripod's pose on /tf_static is enough, although the camera moves a little."""
    folder, camera, stamps = walk
    rough = Pose(*off(camera.poses(0)[0], 0.05, 3.0, np.random.default_rng(4)))
    kind = 'tf2_msgs/msg/TFMessage'
    fixed = make(kind, [transform('map', 'optical', 0, rough)])
    entries = [*driver_messages(walk), ('/tf_static', kind, int(stamps[0]), fixed)]
    bag = write(tmp_path / '0', entries)
    table = truth(folder, bag, tmp_path / 'out', '--tf', 'map,optical')
    assert table['clock_offset']['reason'] == 'the given poses do not move'
    assert errors(tmp_path / 'out', camera).max() < 0.01


def test_odometry_of_its_own_frame_gives_the_motion(tmp_path, bag, walk):
    folder, camera, _ = walk
    rough = Pose(*off(camera.poses(0)[0], 0.05, 3.0, np.random.default_rng(4)))
    options = ['--odometry', '/odom', '--relative', f'--camera-in-body={text(MOUNT.numbers())}']
    truth(folder, bag, tmp_path / 'out', *options, f'--pose={text(rough.numbers())}')
    assert errors(tmp_path / 'out', camera).max() < 0.01


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (f'{HEAD}\n' + '0,1500,2,3,0,0,0,1\n1,1500,2,3,0,0,0,1', 'must be metres'),
        ('t,x,y,z,roll,pitch,yaw\n0,1,2,3,0,0,0', 'must have the columns t, x, y, z, qx'),
        (f'{HEAD}\n0,1,2,3,0,0,0,1', 'must have two poses or more, lines of t x y'),
        (f'{HEAD}\n' + '1,1,2,3,0,0,0,1\n' * 2, 'must have poses at two times or more, got 1'),
        (f'{HEAD}\n0,1,2,3,0,0,0,0\n1,1,2,3,0,0,0,0', 'must have quaternions'),
        (
            f'{HEAD},sx,sy,sz,srx,sry,srz\n' + '0,1,2,3,0,0,0,1,0,1,1,1,1,1\n1' + ',1' * 13,
            'of all six',
        ),
        (f'{HEAD}\n0,1,2,3,0,0,0,1e308\n1,1,2,3,0,0,0,1e308', 'must have quaternions'),
    ],
)
def test_a_trajectory_that_cannot_be_is_one_sentence(tmp_path, walk, content, words):
    path = tmp_path / 'mocap.csv'
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        camera_trajectory(PoseSource(file=path), walk[0] / 'in' / '0.npz')


def test_poses_of_another_time_are_one_sentence(tmp_path, walk, capsys):
    path, out = tmp_path / 'mocap.csv', tmp_path / 'out'
    path.write_text(f'{HEAD}\n9,1,2,3,0,0,0,1\n9.1,1,2,3,0,0,0,1')
    command = ['gap', 'truth', str(walk[0] / 'in'), '--scan', str(walk[0] / 'room.ply')]
    options = ['--trajectory', str(path), '--clock-offset', '0', '--jobs', '1']
    assert main([*command, '--out', str(out), *options]) == 2
    assert 'must have poses at the time of' in ' '.join(capsys.readouterr().err.split())
    assert not out.exists()


def test_a_recording_outside_the_trajectory_is_refused_and_the_others_go_on(tmp_path, walk):
    folder, camera, stamps = walk
    source = folder / 'in' / '0.npz'
    with np.load(source) as archive:
        arrays = dict(archive)
    (tmp_path / 'in').mkdir()
    for name, later in (('0', 0.0), ('1', 100.0), ('2', 0.0)):
        np.savez(tmp_path / 'in' / f'{name}.npz', **{**arrays, 'stamp': stamps / 1e9 + later})
    lines = [HEAD]
    for stamp, pose in zip(stamps / 1e9, bodies(camera), strict=True):
        lines.append(f'{stamp:.9f},{text(pose.numbers())}')
    (tmp_path / 'mocap.csv').write_text('\n'.join(lines))
    options = ['--trajectory', str(tmp_path / 'mocap.csv'), '--clock-offset', '0']
    mount = f'--camera-in-body={text(MOUNT.numbers())}'
    table = truth(folder, tmp_path / 'in', tmp_path / 'out', *options, mount)
    rows = table['recordings']
    assert [row['name'] for row in rows] == ['0.npz', '1.npz', '2.npz']
    assert [row['verdict'] for row in rows] == ['used', 'refused', 'used']
    assert 'must have poses at the time of' in rows[1]['reasons'][0]
    assert errors(tmp_path / 'out', camera).max() < 0.01
    assert not (tmp_path / 'out' / '1.npz').exists()
    assert (tmp_path / 'out' / '2.npz').exists()
    assert 'must have poses at the time of' in (tmp_path / 'out' / 'truth.html').read_text()


SHIFT = 0.037  # seconds that the clock of motion capture is behind


class Swaying(Walk):
    """A walk on which the camera turns to and fro without a period."""

    def pose(self, time):
        """Return the pose at a time in seconds."""
        turn = 0.1 * np.sin(7 * time) + 0.06 * np.sin(17 * time + 1) + 0.05 * np.sin(11.3 * time)
        pose = Pose(*super().pose(time)).moved(np.array([0, 0, 0, 0.3 * turn, turn, 0]))
        return pose.R, pose.t


def sway(camera):
    """Let the camera sway on its walks."""
    scenes = camera.camera.scenes
    scenes.scenes = tuple(
        replace(scene, path=Swaying(**vars(scene.path))) for scene in scenes.scenes
    )


def trajectory(path, camera, seed, behind):
    """Write poses at 100 Hz that are all wrong in the same way, by a clock that is behind."""
    lines, scenes = [], camera.camera.scenes
    for scene, start in zip(scenes.scenes, camera.camera.stamps, strict=True):
        for moment in np.arange(-0.5, scenes.times()[-1] + 0.5, 0.01):
            pose = mesh_pose(scene.path.pose(float(moment)))
            wrong = Pose(*off(pose, 0.05, 3.0, np.random.default_rng(seed)))
            numbers = ' '.join(f'{number:.6f}' for number in wrong.numbers())
            lines.append(f'{start + moment - behind:.6f} {numbers}')
    path.write_text('\n'.join(lines))


def stroll(folder, effects, swaying):
    """Record a walk of 1.3 s, and write its poses at 100 Hz, 5 cm and 3 degrees wrong."""
    camera = ScannedCamera(2, effects, 1, 40, WIDTH, HEIGHT, moving=True)
    if swaying:
        sway(camera)
    (folder / 'in').mkdir()
    camera.record(folder / 'in')
    write_mesh(camera.solids, folder / 'room.ply')
    trajectory(folder / 'mocap.txt', camera, 3, behind=SHIFT)
    return camera, folder / 'mocap.txt'


def open_effects(table):
    return [row['effect'] for row in table['cannot_decide']]


def test_the_offset_of_clocks_is_found_from_the_motion(tmp_path):
    camera, poses = stroll(tmp_path, {}, swaying=True)
    table = truth(tmp_path, tmp_path / 'in', tmp_path / 'out', '--trajectory', str(poses))
    found = table['clock_offset']
    assert found['verdict'] == 'found'
    assert found['seconds'] == pytest.approx(SHIFT, abs=0.004)
    assert found['standard_deviation'] < 0.004
    assert 'latency' not in found
    assert 'time_offset' in open_effects(table)  # A latency would be in it.
    assert errors(tmp_path / 'out', camera).max() < 0.01


def test_a_latency_stays_where_the_offset_of_the_clocks_is_told(tmp_path):
    """Assert that clean depth is that of the stamps, although the images are 50 ms older."""
    camera, poses = stroll(tmp_path, {'time_offset': 1.0}, swaying=True)
    options = '--trajectory', str(poses), '--clock-offset', str(SHIFT)
    table = truth(tmp_path, tmp_path / 'in', tmp_path / 'out', *options)
    assert table['clock_offset']['latency'] == pytest.approx(0.05, abs=0.004)
    assert 'time_offset' not in open_effects(table)
    assert np.median(errors(tmp_path / 'out', camera)) < 0.004
    written = open_recording(tmp_path / 'out' / '0.npz').load()
    seen = written.extra['known'].any(axis=(1, 2))
    assert seen[:30].all()
    assert not seen[-1]  # Nothing shows where the camera was at its stamp.


def test_an_even_motion_does_not_tell_the_offset(tmp_path):
    _, poses = stroll(tmp_path, {}, swaying=False)
    table = truth(tmp_path, tmp_path / 'in', tmp_path / 'out', '--trajectory', str(poses))
    assert table['clock_offset']['verdict'] == 'not found'
    assert 'time_offset' in open_effects(table)


def test_lines_of_tum_are_read(tmp_path):
    path = tmp_path / 'poses.txt'
    path.write_text(
        '# time x y z qx qy qz qw\n1795123456.123456789 1 2 3 0 0 0 1\n\n1e1 4 5 6 0 0 0 2'
    )
    found = read_trajectory(path)
    assert found.stamp_ns.tolist() == [10 * SECOND, 1795123456123456789]
    assert found.poses[1].tolist() == [1, 2, 3, *IDENTITY[3:]]


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (('--odometry', '/no'), "one of '/odom', got '/no'"),
        (('--tf', 'map,nowhere'), 'must be two frames'),
        (('--tf', 'world,optical'), "it has 'base, map, odom, optical'"),
        (('--tf', 'map'), 'must be two frames, PARENT,CHILD'),
        (('--relative',), 'must be given with --trajectory'),
        (('--tf', 'map,optical', '--pose=0,0,0,0,0,0,1'), 'must be given with --relative'),
    ],
)
def test_a_bag_without_these_poses_is_one_sentence(tmp_path, bag, walk, options, words, capsys):
    out = tmp_path / 'out'
    scan = str(walk[0] / 'room.ply')
    command = ['gap', 'truth', str(bag), '--scan', scan, '--out', str(out), '--jobs', '1']
    assert main([*command, *options]) == 2
    assert words in ' '.join(capsys.readouterr().err.split())
    assert not out.exists()

"""Rough poses for ground truth from a scan: files of motion capture, with errors, and clocks."""

from dataclasses import replace

from campaigns import change
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.clock import find_offset
from flexx2_sim_ros.truth.trajectory import (
    camera_trajectory,
    IDENTITY,
    PoseSource,
    read_trajectory,
)
import numpy as np
import pytest
from scans import bodies, box, errors, IN_BODY, MOUNT, record, refused, rough, SMALL_K, text, truth
from scipy.spatial.transform import Rotation
from study.blind.meshes import mesh_pose
from study.blind.rooms import Path as Walk

SECOND = 1_000_000_000
CLOCK = 1_700_000_000  # seconds: what motion capture calls the recording's time 0
HEAD = 't,x,y,z,qx,qy,qz,qw'


@pytest.fixture(scope='module')
def walk(tmp_path_factory):
    """Return a folder with `in/0.npz` and `room.ply`, the camera, and stamps in seconds."""
    folder = tmp_path_factory.mktemp('walk')
    camera = record(folder, {}, recordings=1, moving=True)
    return folder, camera, open_recording(folder / 'in' / '0.npz').stamp


def write_poses(path, times, poses):
    """Write poses at times in seconds, as TUM does."""
    rows = [[time, *pose.numbers()] for time, pose in zip(times, poses, strict=True)]
    np.savetxt(path, rows, '%.9f')
    return path


def test_motion_capture_starts_a_walk_though_it_is_wrong(tmp_path, walk):
    """Assert it for a body 5 cm and 3 degrees off, and a clock that is 30 ms late besides."""
    folder, camera, stamps = walk
    told = bodies(camera, wrong=True)
    # Before and after, so that the late clock has poses too.
    told = [told[0], *told, told[-1]]
    times = CLOCK + 0.03 + np.array([stamps[0] - 0.1, *stamps, stamps[-1] + 0.1])
    lines = ['frame,qw,qx,qy,qz,x,y,z,time']
    for time, pose in zip(times, told, strict=True):
        x, y, z, qx, qy, qz, qw = pose.numbers()
        lines.append(f'7,{qw},{qx},{qy},{qz},{x},{y},{z},{time:.6f}')
    lines.insert(3, '7,,,,,,,,')  # the marker was hidden
    path = tmp_path / 'vicon.csv'
    path.write_text('\n'.join(lines))
    options = '--trajectory', path, IN_BODY, f'--clock-offset=-{CLOCK}'
    scan = '--scan', folder / 'room.ply'
    (row,) = truth(tmp_path / 'out', folder / 'in', *scan, *options)['recordings']
    assert errors(tmp_path / 'out', camera).max() < 0.01
    assert 30 < row['told_off_mm'] < 80
    assert 2 < row['told_off_deg'] < 4.5


@pytest.fixture
def still(tmp_path):
    """Return the options for eight frames of a box, `r.npz`; the camera's pose, and depth."""
    pose, depth = box(tmp_path)
    noise = np.random.default_rng(1).normal(0, 0.002, (8, *depth.shape))
    seen, stamp = (depth + noise).astype(np.float32), np.arange(8) / 30
    np.savez(tmp_path / 'r.npz', depth=seen, K=SMALL_K, stamp=stamp)
    words = tmp_path / 'r.npz', '--scan', tmp_path / 'room.ply', '--trajectory'
    return words, pose, depth


def shifted(pose, metres):
    """Return a pose farther along x of the room."""
    return Pose(pose.R, pose.t + (metres, 0, 0))


@pytest.mark.parametrize(('moves', 'motion'), [(0.0, 'still'), (0.1, 'moving')])
def test_given_poses_tell_the_motion(tmp_path, still, moves, motion):
    words, pose, _ = still
    times = np.arange(8) / 30
    poses = [shifted(pose, moves * (time > 0.1)) for time in times]
    path = write_poses(tmp_path / 'vicon.txt', times, poses)
    (row,) = truth(tmp_path / 'out', *words, path, '--clock-offset', 0)['recordings']
    assert row['motion'] == motion


def test_given_poses_are_never_left(tmp_path, still, capsys):
    words, pose, _ = still
    path = write_poses(tmp_path / 'vicon.txt', np.arange(8) / 30, [shifted(pose, 0.45)] * 8)
    said = refused(capsys, tmp_path / 'out', *words, path, '--clock-offset', 0)
    assert 'degrees from the given one' in said


def test_poses_of_a_known_accuracy_are_used_as_they_are(tmp_path, still):
    """Assert it for a camera that shows another pose, and a folder of trajectories."""
    words, pose, depth = still
    (tmp_path / 'poses').mkdir()
    # There is no pose for the last two frames.
    times = np.arange(6) / 30
    poses = [shifted(pose, 0.02 + 0.5 * time) for time in times]
    write_poses(tmp_path / 'poses' / 'r.txt', times, poses)
    options = '--clock-offset', 0, '--pose-accuracy', '0.002,0.2'
    (row,) = truth(tmp_path / 'out', *words, tmp_path / 'poses', *options)['recordings']
    assert (row['motion'], row['pose_sigma_mm']) == ('moving', 2.0)
    assert row['pose'][0] == pytest.approx(poses[0].t[0])
    written = open_recording(tmp_path / 'out' / 'r.npz').load()
    known = written.extra['known'].mean(axis=(1, 2))
    assert (known > 0.9).tolist() == [True] * 6 + [False] * 2
    assert np.abs(written.clean_depth[5] - depth).max() > 0.05


def test_motion_capture_of_a_still_camera_may_begin_late(tmp_path, still):
    words, pose, _ = still
    path = write_poses(tmp_path / 'vicon.txt', np.arange(3, 8) / 30, [pose] * 5)
    options = '--clock-offset', 0, '--pose-accuracy', '0.002,0.2', '--motion', 'still'
    (row,) = truth(tmp_path / 'out', *words, path, *options)['recordings']
    assert (row['verdict'], row['motion']) == ('used', 'still')
    assert row['pose'][:3] == pytest.approx(pose.t)


@pytest.mark.parametrize('wrong', [False, True])
def test_a_camera_that_is_mounted_otherwise_than_told_is_doubtful(tmp_path, walk, wrong):
    """Assert it for poses of motion capture: a mount that is off looks like errors of depth."""
    folder, camera, stamps = walk
    path = write_poses(tmp_path / 'vicon.txt', stamps, bodies(camera))
    motion = np.array([0.03, -0.01, 0.02, 0.0, np.radians(2), 0.0])
    told = MOUNT.moved(motion) if wrong else MOUNT
    options = '--trajectory', path, f'--camera-in-body={text(told)}', '--clock-offset', 0
    options += '--pose-accuracy', '0.002,0.2'
    scan = '--scan', folder / 'room.ply'
    (row,) = truth(tmp_path / 'out', folder / 'in', *scan, *options)['recordings']
    assert row['verdict'] == ('doubtful' if wrong else 'used')
    if wrong:
        said = next(reason for reason in row['reasons'] if 'measure --camera-in-body' in reason)
        shown = said.partition('show: ')[2].strip(')')
        off_by = MOUNT.motion_to(Pose.from_numbers(np.array(shown.split(','), float)))
        assert np.abs(off_by[:3]).max() < 0.005
        assert np.abs(off_by[3:]).max() < np.radians(0.3)


@pytest.mark.parametrize(
    ('columns', 'options', 'words'),
    [
        (',sx,sy', ['--clock-offset', '0'], 'must have all of the columns sx, sy, sz'),
        (',sx,sy,sz,srx,sry,srz', [], 'sry, srz: must be given with poses in the room and'),
        (',sx,sy,sz,srx,sry,srz', ['--clock-offset', '0', '--relative'], 'poses in the room and'),
    ],
)
def test_an_accuracy_that_cannot_be_used_is_one_sentence(
    tmp_path, still, capsys, columns, options, words
):
    path, count = tmp_path / 'mocap.csv', columns.count(',')
    rows = (f'{when},1,2,3,0,0,0,1' + ',0.001' * count for when in (-0.1, 0.4))
    path.write_text('\n'.join([HEAD + columns, *rows]))
    assert words in refused(capsys, tmp_path / 'out', *still[0], path, *options)


def test_poses_of_another_time_are_one_sentence(tmp_path, still, capsys):
    words, pose, _ = still
    path = write_poses(tmp_path / 'mocap.txt', [9, 9.1], [pose, pose])
    said = refused(capsys, tmp_path / 'out', *words, path, '--clock-offset', 0)
    assert 'must have poses at the time of' in said


def test_a_recording_outside_the_trajectory_is_refused_and_the_others_go_on(tmp_path, still):
    words, pose, _ = still
    (tmp_path / 'in').mkdir()
    for name, later in (('0', 0.0), ('1', 100.0), ('2', 0.0)):
        (tmp_path / 'in' / f'{name}.npz').write_bytes(words[0].read_bytes())
        change(tmp_path / 'in' / f'{name}.npz', stamp=np.arange(8) / 30 + later)
    path = write_poses(tmp_path / 'mocap.txt', np.arange(8) / 30, [pose] * 8)
    out, options = tmp_path / 'out', (*words[1:], path, '--clock-offset', 0)
    rows = truth(out, tmp_path / 'in', *options)['recordings']
    assert [row['name'] for row in rows] == ['0.npz', '1.npz', '2.npz']
    assert [row['verdict'] for row in rows] == ['used', 'refused', 'used']
    assert 'must have poses at the time of' in rows[1]['reasons'][0]
    assert sorted(path.name for path in out.glob('*.npz')) == ['0.npz', '2.npz']
    assert 'must have poses at the time of' in (out / 'truth.html').read_text()


def test_lines_of_tum_are_read(tmp_path):
    path = tmp_path / 'poses.txt'
    path.write_text(
        '# time x y z qx qy qz qw\n1795123456.123456789 1 2 3 0 0 0 1\n\n1e1 4 5 6 0 0 0 2'
    )
    found = read_trajectory(path)
    assert found.stamp_ns.tolist() == [10 * SECOND, 1795123456123456789]
    assert found.poses[1].tolist() == [1, 2, 3, *IDENTITY[3:]]


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
def test_a_trajectory_that_cannot_be_is_one_sentence(tmp_path, content, words):
    path = tmp_path / 'mocap.csv'
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        camera_trajectory(PoseSource(file=path), tmp_path / '0.npz')


SHIFT = 0.037  # seconds that the clock of motion capture is behind


class Swaying(Walk):
    """A walk on which the camera turns to and fro without a period."""

    def pose(self, time):
        """Return the pose at a time in seconds."""
        turn = 0.1 * np.sin(7 * time) + 0.06 * np.sin(17 * time + 1) + 0.05 * np.sin(11.3 * time)
        pose = Pose(*super().pose(time)).moved(np.array([0, 0, 0, 0.3 * turn, turn, 0]))
        return pose.R, pose.t


def sway(camera):
    """Let the camera sway on its walk."""
    (scene,) = camera.camera.scenes.scenes
    camera.camera.scenes.scenes = (replace(scene, path=Swaying(**vars(scene.path))),)


def stroll(folder, effects):
    """
    Record a walk of 1.3 s.

    Returns the camera and the options for its poses at 100 Hz, all wrong in the same way, by a
    clock that is behind.
    """
    camera = record(folder, effects, sway, recordings=1, frames=40, moving=True)
    (scene,), (start,) = camera.camera.scenes.scenes, camera.camera.stamps
    moments = np.arange(-0.5, camera.camera.scenes.times()[-1] + 0.5, 0.01)
    poses = [mesh_pose(scene.path.pose(float(moment))) for moment in moments]
    told = [rough(pose, np.random.default_rng(3)) for pose in poses]
    path = write_poses(folder / 'mocap.txt', start + moments - SHIFT, told)
    return camera, (folder / 'in', '--scan', folder / 'room.ply', '--trajectory', path)


def open_effects(table):
    return [row['effect'] for row in table['cannot_decide']]


def test_the_offset_of_clocks_is_found_from_the_motion(tmp_path):
    camera, words = stroll(tmp_path, {})
    table = truth(tmp_path / 'out', *words)
    found = table['clock_offset']
    assert found['verdict'] == 'found'
    assert found['seconds'] == pytest.approx(SHIFT, abs=0.004)
    assert found['standard_deviation'] < 0.004
    assert 'latency' not in found
    assert 'time_offset' in open_effects(table)  # A latency would be in it.
    assert errors(tmp_path / 'out', camera).max() < 0.01


def test_a_latency_stays_where_the_offset_of_the_clocks_is_told(tmp_path):
    """Assert that clean depth is that of the stamps, although the images are 50 ms older."""
    camera, words = stroll(tmp_path, {'time_offset': 1.0})
    table = truth(tmp_path / 'out', *words, '--clock-offset', SHIFT)
    assert table['clock_offset']['latency'] == pytest.approx(0.05, abs=0.004)
    assert 'time_offset' not in open_effects(table)
    assert np.median(errors(tmp_path / 'out', camera)) < 0.004
    written = open_recording(tmp_path / 'out' / '0.npz').load()
    seen = written.extra['known'].any(axis=(1, 2))
    assert seen[:30].all()
    assert not seen[-1]  # Nothing shows where the camera was at its stamp.


def turning(about):
    """Return a function of stamps that gives poses: angles about y, radians, of seconds."""

    def poses(stamp_ns):
        time = stamp_ns / SECOND
        turns = Rotation.from_euler('y', about(time)[:, None]).as_quat()
        return np.column_stack([0.3 * time, np.zeros((len(time), 2)), turns])

    return poses


def swaying(time):
    return 0.1 * np.sin(7 * time) + 0.06 * np.sin(17 * time + 1)


def humming(time):
    return 0.1 * np.sin(12 * time) + 0.005 * np.sin(31 * time)


@pytest.mark.parametrize(
    ('seen', 'told', 'said'),
    [
        (lambda time: 0.4 * time, lambda time: 0.4 * time, 'moves too evenly'),
        (swaying, lambda time: 0.1 * np.sin(23 * time), 'do not move as the camera does'),
        (humming, lambda time: 0.1 * np.sin(12 * time), 'another offset fits nearly as well'),
    ],
)
def test_motions_that_do_not_tell_the_offset_of_clocks(seen, told, said):
    stamp_ns, span = np.arange(40) * SECOND // 30, (-SECOND, 3 * SECOND)
    assert said in find_offset(stamp_ns, turning(seen), turning(told), span, 0.0).reason

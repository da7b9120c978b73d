"""The files that `flexx2 gap truth` reads and writes, and the time since power-on in them."""

from copy import deepcopy

from campaigns import change
from flexx2_sim_ros.errors import InputError, MachineError
from flexx2_sim_ros.gap.data.hidden import hidden_effects
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.recording.convert import convert
from flexx2_sim_ros.truth import make_truth, PlaneRequest
from flexx2_sim_ros.truth.files import uptimes, write_results
from flexx2_sim_ros.truth.run import GivenRecording, no_progress, running, TruthRequest
import numpy as np
import pytest
from scans import refused, SMALL_K, truth

START = 1.7e9  # seconds


def small_wall(path, distance, **changes):
    """Write a recording of a wall from the front, in few pixels."""
    noise = np.random.default_rng(4).normal(0, 0.003, (3, 24, 32))
    depth = (distance + noise).astype(np.float32)
    path.parent.mkdir(exist_ok=True)
    np.savez(path, depth=depth, K=SMALL_K, stamp=np.arange(3) / 30, usecase='Mode_9_30fps')
    change(path, **changes)
    return path


@pytest.fixture
def wall_yaml(tmp_path):
    path = tmp_path / 'planes.yaml'
    path.write_text('schema: 1\nplanes:\n- name: wall\n')
    return path


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (('--scan', 'room.ply', '--clock-offset', '0'), '--trajectory, --odometry or --tf'),
        (('--scan', 'room.ply', '--lens-error', '0'), '--board'),
        (('--board', 'target.yaml', '--clock-offset', '0'), '--scan or --scene'),
        (('--board', 'target.yaml', '--room-error', '0'), '--scan, --scene or --planes'),
        (('--planes', 'planes.yaml', '--clock-offset', '0'), '--scan or --scene'),
    ],
)
def test_an_option_of_another_kind_of_truth_is_refused_also_if_it_is_0(
    options, words, tmp_path, capsys
):
    error = refused(capsys, tmp_path / 'out', 'wall.npz', *options)
    assert error == f'{options[2]}: must be given with {words} only'


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (['--pose=1,2,3'], '--pose: must be'),
        (['--pose=0,0,0,0,0,0,0'], '--pose: must be'),
        (['--pose=a,b,c,d,e,f,g'], '--pose: must be'),
        (['--pose=nan,0,0,0,0,0,1'], '--pose: must be'),
        (['--pose=0,0,0,0,0,0,1', '--tf', 'map,optical'], 'must be given with --relative'),
        (['--relative'], 'must be given with --trajectory'),
        (['--tf', 'map'], 'must be two frames, PARENT,CHILD'),
        (['--trajectory', 'a.csv', '--pose-accuracy', '2'], 'must be METRES,DEGREES'),
        (['--trajectory', 'a.csv', '--pose-accuracy', '0,0.2'], 'must be METRES,DEGREES'),
        (
            ['--trajectory', 'a.csv', '--pose-accuracy', 'recorded'],
            'must be METRES,DEGREES without --odometry',
        ),
    ],
)
def test_poses_that_cannot_be_are_refused_before_a_file_is_read(options, words, tmp_path, capsys):
    assert words in refused(capsys, tmp_path / 'out', 'x.npz', '--scan', 'room.ply', *options)


def test_no_recording_is_overwritten_by_another_one(tmp_path, wall_yaml, capsys):
    days = tmp_path / 'monday', tmp_path / 'tuesday'
    for day in days:
        small_wall(day / 'wall.npz', 1.2)
    # Monday's wall.npz would be written over that of Tuesday, also where a link leads there.
    (tmp_path / 'link').symlink_to(tmp_path / 'tuesday')
    for out in ('tuesday', 'link'):
        error = refused(capsys, tmp_path / out, *days, '--planes', wall_yaml)
        assert '--out: must be a folder where no input is overwritten, got ' in error


def test_no_recording_is_overwritten_by_the_bag_beside_it(tmp_path, wall_yaml, capsys):
    folder = tmp_path / 'rec'
    convert(small_wall(folder / 'wall.npz', 1.2), folder / 'wall')
    error = refused(capsys, folder, folder, '--planes', wall_yaml)
    assert '--out: must be a folder where no input is overwritten' in error


def test_a_recording_without_truth_in_the_folder_is_not_replaced(tmp_path, wall_yaml, capsys):
    path = small_wall(tmp_path / 'in' / 'wall.npz', 1.2)
    small_wall(tmp_path / 'out' / 'wall.npz', 1.4)
    error = refused(capsys, tmp_path / 'out', path, '--planes', wall_yaml)
    assert 'wall.npz there has no clean_depth and would be replaced' in error


def test_the_file_of_the_planes_is_not_overwritten(tmp_path, wall_yaml, capsys):
    path = small_wall(tmp_path / 'in' / 'wall.npz', 1.2)
    planes = wall_yaml.rename(tmp_path / 'truth.yaml')
    assert 'no input is overwritten' in refused(capsys, tmp_path, path, '--planes', planes)


def test_assumed_stamps_are_those_of_the_profile_and_said_once(tmp_path, wall_yaml, capsys):
    profile = tmp_path / 'slow.yaml'
    profile.write_text(
        'schema: 1\nmodel: Slow\nintrinsics: {width: 32, height: 24, fx: 25, fy: 25, cx: 15.5, '
        'cy: 11.5, distortion: [0, 0, 0, 0, 0]}\nmodes:\n  slow: {rate_hz: 5, range_m: [0.1, 5], '
        'modulation_hz: null, raw_frames: null, exposure_us: null, '
        'noise: {a: 0.003, b: 0, c: 0, d: 0, n: 2.7, sigma_x: 0}}\n'
    )
    for name, distance in (('near', 0.9), ('far', 1.2)):
        small_wall(tmp_path / 'in' / f'{name}.npz', distance, stamp=None, usecase='slow')
    out = tmp_path / 'out'
    table = truth(out, tmp_path / 'in', '--planes', wall_yaml, '--profile', profile)
    for name in ('near', 'far'):
        written = open_recording(out / f'{name}.npz')
        assert written.stamp.tolist() == pytest.approx([0, 0.2, 0.4])
    said = ' '.join(capsys.readouterr().err.split())
    assert said.count('stamp: not in the file: taken for 5 Hz, that of slow') == 1
    assert all('taken for 5 Hz' in row['notes'][0] for row in table['recordings'])


def test_a_campaign_of_many_recordings_can_be_diagnosed(tmp_path, wall_yaml):
    """Write truth.yaml as for 400 recordings, and 2,000 names that a shell wrote out."""
    path = small_wall(tmp_path / 'in' / 'wall.npz', 1.2)
    names = ' '.join(f'recordings/{i:04d}.npz' for i in range(2000))
    out = tmp_path / 'out'
    request = PlaneRequest(
        recordings=(path,), planes=wall_yaml, out=out, command=f'flexx2 gap truth {names} --jobs 1'
    )
    table = make_truth(request)
    assert len(table['command']) < 3000
    assert table['command'].startswith('flexx2 gap truth recordings/0000.npz')
    assert table['command'].endswith('--jobs 1')
    row = table['recordings'][0]
    table['recordings'] = [deepcopy(row) for _ in range(400)]
    write_results(out, table, '')
    hidden = {row.effect for row in hidden_effects(out)}
    assert hidden == {row['effect'] for row in table['cannot_decide'] if 'absorbed' in row}


def test_files_of_a_folder_that_cannot_be_used_are_refused_and_the_others_go_on(
    tmp_path, wall_yaml, capsys
):
    folder = tmp_path / 'in'
    good = small_wall(folder / 'good.npz', 1.2)
    cut = folder / 'cut.npz'
    cut.write_bytes(good.read_bytes()[:2000])
    small_wall(folder / 'blind.npz', np.nan)
    (folder / 'gone.npz').symlink_to(tmp_path / 'nothing.npz')
    out = tmp_path / 'out'
    out.mkdir()
    # What no run has written stays; ground truth of an earlier run does not.
    np.savez(out / 'cut.npz', map=np.ones((3, 4)))
    np.savez(out / 'blind.npz', clean_depth=np.ones((3, 4)))
    planes = '--planes', wall_yaml
    rows = truth(out, folder, *planes)['recordings']
    states = {row['name']: row['verdict'] for row in rows}
    assert states == dict.fromkeys(('blind.npz', 'cut.npz', 'gone.npz'), 'refused') | {
        'good.npz': 'used'
    }
    reasons = {row['name']: row['reasons'][0] for row in rows if row['reasons']}
    assert reasons['blind.npz'] == 'depth: all pixels of all frames are invalid'
    assert all(reasons[name] for name in ('cut.npz', 'gone.npz'))
    assert sorted(path.name for path in out.glob('*.npz')) == ['cut.npz', 'good.npz']
    said = ' '.join(capsys.readouterr().err.split())
    assert 'cut.npz: refused: ' in said
    # A file that was named itself may be a wrong name, and nothing is left without a good one.
    assert str(cut) in refused(capsys, out, good, cut, *planes)
    good.unlink()
    assert 'depth: all pixels of all frames are invalid' in refused(capsys, out, folder, *planes)


def test_a_bag_that_is_the_current_folder_gives_its_name(tmp_path, wall_yaml, monkeypatch):
    convert(small_wall(tmp_path / 'in' / 'wall.npz', 1.2), tmp_path / 'corner')
    monkeypatch.chdir(tmp_path / 'corner')
    truth(tmp_path / 'out', '.', '--planes', wall_yaml)
    assert (tmp_path / 'out' / 'corner.npz').is_file()


@pytest.mark.parametrize(('error', 'kept'), [(MachineError, True), (InputError, False)])
def test_what_is_done_stays_if_the_machine_fails(error, kept, tmp_path):
    out = tmp_path / 'out'

    def fail():
        with running(TruthRequest(recordings=(), out=out), no_progress) as run:
            job = (GivenRecording(tmp_path, TruthRequest(recordings=(), out=out)),)
            run.each_once('registering', (0.0, 1.0), repr, [job])
            raise error('--jobs: must be fewer')

    with pytest.raises(error):
        fail()
    assert out.exists() == kept


def opened(folder, starts, **more):
    """Write recordings of three frames, half a second apart, that begin at these stamps."""
    times = [start + np.arange(3) * 0.5 for start in starts]
    paths = [
        small_wall(folder / f'{number}.npz', 1.2, stamp=stamp, **more)
        for number, stamp in enumerate(times)
    ]
    return [open_recording(path) for path in paths]


def test_stamps_say_how_long_after_one_another_recordings_were_made(tmp_path):
    readers = opened(tmp_path, [START + 60, START, START + 600])
    counted = [60, 60.5, 61], [0, 0.5, 1], [600, 600.5, 601]
    assert np.array_equal(uptimes(readers), counted)
    assert uptimes(readers, 20.0)[1][0] == 20


def test_the_uptime_that_a_recording_says_is_kept(tmp_path):
    readers = opened(tmp_path, [START, START + 60], uptime=np.array(300.0))
    assert uptimes(readers)[0].tolist() == [300, 300.5, 301]
    with pytest.raises(InputError, match='--uptime: must not be given'):
        uptimes(readers, 20.0)


@pytest.mark.parametrize('starts', [(0.0, 0.0), (START, START + 0.5), (START, START + 2e5)])
def test_stamps_of_several_clocks_or_sessions_say_nothing(tmp_path, starts):
    readers = opened(tmp_path, starts)
    assert uptimes(readers) == [None, None]
    with pytest.raises(InputError, match='--uptime: must be given for recordings of one session'):
        uptimes(readers, 20.0)

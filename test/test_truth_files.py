"""The files that `flexx2 gap truth` reads and writes."""

from copy import deepcopy

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError, MachineError
from flexx2_sim_ros.gap.data.hidden import hidden_effects
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.recording.convert import convert
from flexx2_sim_ros.truth import make_truth, PlaneRequest
from flexx2_sim_ros.truth.files import write_results
from flexx2_sim_ros.truth.run import GivenRecording, no_progress, running, TruthRequest
import numpy as np
import pytest
import yaml

MODE = 'Mode_9_30fps'


def small_wall(path, distance, **changes):
    """Write a recording of a wall from the front, in few pixels."""
    K = np.array([[25.0, 0, 15.5], [0, 25, 11.5], [0, 0, 1]])  # noqa: N806
    noise = np.random.default_rng(4).normal(0, 0.003, (3, 24, 32))
    depth = (distance + noise).astype(np.float32)
    arrays = {'depth': depth, 'K': K, 'stamp': np.arange(3) / 30, 'usecase': MODE, **changes}
    path.parent.mkdir(exist_ok=True)
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


@pytest.fixture
def wall_yaml(tmp_path):
    path = tmp_path / 'planes.yaml'
    path.write_text('schema: 1\nplanes:\n- name: wall\n')
    return path


def refused(capsys, *words):
    """Return the error of the command."""
    assert main(['gap', 'truth', *map(str, words), '--jobs', '1']) == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


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
    error = refused(capsys, 'wall.npz', *options, '--out', tmp_path / 'out')
    assert error == f'flexx2: error: {options[2]}: must be given with {words} only'


def test_no_recording_is_overwritten_by_another_one(tmp_path, wall_yaml, capsys):
    days = [small_wall(tmp_path / day / 'wall.npz', 1.2) for day in ('monday', 'tuesday')]
    before = [path.read_bytes() for path in days]
    # Monday's wall.npz would be written over that of Tuesday, also where a link leads there.
    (tmp_path / 'link').symlink_to(tmp_path / 'tuesday')
    for out in ('tuesday', 'link'):
        given = tmp_path / 'monday', tmp_path / 'tuesday'
        error = refused(capsys, *given, '--planes', wall_yaml, '--out', tmp_path / out)
        assert '--out: must be a folder where no input is overwritten, got ' in error
        assert [path.read_bytes() for path in days] == before
        assert [path.name for path in (tmp_path / 'tuesday').iterdir()] == ['wall.npz']


def test_no_recording_is_overwritten_by_the_bag_beside_it(tmp_path, wall_yaml, capsys):
    there = small_wall(tmp_path / 'rec' / 'wall.npz', 1.2)
    assert main(['convert', str(there), str(tmp_path / 'rec' / 'wall')]) == 0
    before = there.read_bytes()
    error = refused(capsys, there.parent, '--planes', wall_yaml, '--out', there.parent)
    assert '--out: must be a folder where no input is overwritten' in error
    assert there.read_bytes() == before


def test_a_recording_without_truth_in_the_folder_is_not_replaced(tmp_path, wall_yaml, capsys):
    path = small_wall(tmp_path / 'in' / 'wall.npz', 1.2)
    raw = small_wall(tmp_path / 'out' / 'wall.npz', 1.4)
    before = raw.read_bytes()
    error = refused(capsys, path, '--planes', wall_yaml, '--out', tmp_path / 'out')
    assert 'wall.npz there has no clean_depth and would be replaced' in error
    assert raw.read_bytes() == before


def test_the_file_of_the_planes_is_not_overwritten(tmp_path, wall_yaml, capsys):
    path = small_wall(tmp_path / 'in' / 'wall.npz', 1.2)
    planes = wall_yaml.rename(tmp_path / 'truth.yaml')
    before = planes.read_bytes()
    assert 'no input is overwritten' in refused(
        capsys, path, '--planes', planes, '--out', tmp_path
    )
    assert planes.read_bytes() == before


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
    words = [str(tmp_path / 'in'), '--planes', str(wall_yaml), '--out', str(out), '--jobs', '1']
    assert main(['gap', 'truth', *words, '--profile', str(profile)]) == 0
    for name in ('near', 'far'):
        written = open_recording(out / f'{name}.npz')
        assert written.stamp.tolist() == pytest.approx([0, 0.2, 0.4])
    said = ' '.join(capsys.readouterr().err.split())
    assert said.count('stamp: not in the file: taken for 5 Hz, that of slow') == 1
    rows = yaml.safe_load((out / 'truth.yaml').read_text())['recordings']
    assert all('taken for 5 Hz' in row['notes'][0] for row in rows)


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
    words = ['gap', 'truth', '--planes', str(wall_yaml), '--out', str(out), '--jobs', '1']
    assert main([*words, str(folder)]) == 0
    rows = yaml.safe_load((out / 'truth.yaml').read_text())['recordings']
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
    assert str(cut) in refused(capsys, good, cut, *words[2:])
    good.unlink()
    assert 'depth: all pixels of all frames are invalid' in refused(capsys, folder, *words[2:])


def test_a_bag_that_is_the_current_folder_gives_its_name(tmp_path, wall_yaml, monkeypatch):
    convert(small_wall(tmp_path / 'in' / 'wall.npz', 1.2), tmp_path / 'corner')
    monkeypatch.chdir(tmp_path / 'corner')
    words = ['gap', 'truth', '.', '--planes', str(wall_yaml), '--out', str(tmp_path / 'out')]
    assert main([*words, '--jobs', '1']) == 0
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

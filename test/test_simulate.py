"""`flexx2 simulate` and `flexx2 modes`: what they write and print, and what they say if not."""

from pathlib import Path
import re

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.truth import read_truth
import numpy as np
import pytest
import yaml

K = np.array([[52.0, 0.0, 27.5], [0.0, 53.0, 21.0], [0.0, 0.0, 1.0]])
SCENE = np.full((43, 56), 1.5, np.float32)
SCENE[:, 30:] = 2.2
SCENE[:5] = np.nan
ROOT = Path(__file__).resolve().parents[1]


def save(folder, **arrays):
    """Save a scene with these arrays replaced, added, or left out where None."""
    content = {'clean_depth': SCENE, 'K': K, **arrays}
    path = folder / 'in.npz'
    np.savez(path, **{key: value for key, value in content.items() if value is not None})
    return str(path)


def simulate(source, folder, *options):
    """Run the command, which has to succeed, and read what it wrote."""
    out = folder / 'out.npz'
    assert main(['simulate', source, str(out), *options]) == 0
    with np.load(out, allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def test_simulate_writes_the_librarys_frames(tmp_path, capsys):
    options = ['--usecase', 'mode_5_45FPS', '--frames', '70', '--seed', '7', '--name', 'left']
    out = simulate(save(tmp_path), tmp_path, *options)
    said = ' '.join(capsys.readouterr().err.split())
    assert '70 frames of 56 x 43, Flexx2, Mode_5_45fps, ' in said
    assert (out['depth'].shape, out['depth'].dtype) == ((70, 43, 56), np.float32)
    assert (out['stamp'].shape, out['stamp'].dtype) == ((70,), np.float64)
    start = out['stamp'][0]
    assert out['stamp'] - start == pytest.approx(np.arange(70) / 45, abs=2e-9)
    assert out['usecase'] == 'Mode_5_45fps'
    assert int(out['seed']) == 7
    np.testing.assert_array_equal(out['clean_depth'], SCENE)
    np.testing.assert_array_equal(out['K'], K)
    camera = Camera('Mode_5_45fps', seed=7, name='left')
    for index in (0, 1, 29, 30, 69):
        for stamp in (out['stamp'][index], round(start * 1e9 + index * 1e9 / 45)):
            wanted = camera.capture(SCENE, K, stamp).depth
            np.testing.assert_array_equal(out['depth'][index], wanted)


def test_scenes_differ_in_noise_and_share_the_fixed_pattern(tmp_path):
    """
    Assert that a scene always has the same noise, another scene another, all one fixed pattern.

    False failures: correlations of 2,400 pixels are known to 0.02.
    """
    shown = {}
    for distance in (1.5, 2.0, 1.5):
        for effects in ((), ('--effects', 'fixed_pattern')):
            source = save(tmp_path, clean_depth=np.full((43, 56), distance, np.float32))
            out = simulate(source, tmp_path, '--frames', '200', *effects)
            again = shown.setdefault((distance, effects), out)
            np.testing.assert_array_equal(again['depth'], out['depth'])
    noise = [shown[distance, ()]['depth'][0].ravel() for distance in (1.5, 2.0)]
    assert abs(np.corrcoef(noise)[0, 1]) < 0.15
    with_grain = [shown[distance, ('--effects', 'fixed_pattern')] for distance in (1.5, 2.0)]
    grain = [one['depth'].mean(axis=0).ravel() for one in with_grain]
    assert np.corrcoef(grain)[0, 1] > 0.7


def test_the_first_stamp_is_given(tmp_path):
    source = save(tmp_path)
    out = simulate(source, tmp_path, '--frames', '3', '--start', '7.5')
    assert out['stamp'] == pytest.approx(7.5 + np.arange(3) / 30, abs=1e-9)
    for start in ('-1', 'nan'):
        assert main(['simulate', source, str(tmp_path / 'x.npz'), '--start', start]) == 2


def test_uptime_of_the_scene_or_as_given(tmp_path):
    """
    Assert that a drift of 50 mm is what it is at that time after power-on.

    False failures: 2,400 pixels of 5 frames know the depth to 0.1 mm.
    """
    effects = tmp_path / 'drift.yaml'
    effects.write_text('schema: 1\neffects: {warm_up_drift: {bias: 0.05, tau: 100}}\n')
    options = ('--frames', '5', '--effects', str(effects))
    for uptime, more, expected in (
        (None, (), 0.0),
        (100.0, (), 100.0),
        (np.full(5, 50.0), (), 50.0),
        (100.0, ('--uptime', '200'), 200),
        (None, ('--uptime', '30'), 30.0),
    ):
        source = save(tmp_path, clean_depth=np.full((43, 56), 1.0), uptime=uptime)
        out = simulate(source, tmp_path, *options, *more)
        assert np.mean(out['depth']) - 1 == pytest.approx(0.05 * np.exp(-expected / 100), abs=1e-3)
        assert more == () or out['uptime'] == expected
    for bad in ('-1', 'nan', '1e9'):
        assert main(['simulate', source, str(tmp_path / 'x.npz'), '--uptime', bad]) == 2
    source = save(tmp_path, uptime=np.array('late'))
    assert main(['simulate', source, str(tmp_path / 'x.npz')]) == 2


def test_a_moving_scene_is_simulated_frame_by_frame(tmp_path):
    scenes = np.stack([SCENE + 0.1 * step for step in range(35)])
    stamps = np.cumsum(np.linspace(0.01, 0.05, 35)) + 1000.0
    paint = np.random.default_rng(3).uniform(0, 1, scenes.shape).astype(np.float32)
    arrays = {'clean_depth': scenes, 'stamp': stamps, 'reflectivity': paint}
    source = save(tmp_path, **arrays, note=np.array('three steps'))
    out = simulate(source, tmp_path, '--seed', '2')
    for key, given in arrays.items():
        np.testing.assert_array_equal(out[key], given)
    assert out['note'] == 'three steps'
    camera = Camera('Mode_9_30fps', seed=2)
    for index in (0, 29, 30, 34):
        wanted = camera.capture(scenes[index], K, stamps[index]).depth
        np.testing.assert_array_equal(out['depth'][index], wanted)
    fewer = simulate(source, tmp_path, '--frames', '4')
    for key in ('depth', 'clean_depth', 'reflectivity', 'stamp'):
        assert len(fewer[key]) == 4


@pytest.mark.parametrize('keys', [('stamp', 'stamp_ns'), ('stamp_ns',)])
def test_stamps_of_a_clock_are_kept_to_the_nanosecond(keys, tmp_path):
    exact = 1_700_000_000_123_456_789 + np.arange(5) * 33_333_333
    stamps = {'stamp': exact / 1e9, 'stamp_ns': exact}
    given = {key: stamps[key] for key in keys}
    source = save(tmp_path, clean_depth=np.stack([SCENE] * 5), **given)
    out = simulate(source, tmp_path, '--frames', '3', '--seed', '2')
    np.testing.assert_array_equal(out['stamp_ns'], exact[:3])
    recording = load_recording(tmp_path / 'out.npz')
    np.testing.assert_array_equal(recording.stamp, exact[:3] / 1e9)
    seen = Camera('Mode_9_30fps', seed=2).capture(SCENE, K, exact[:3])
    np.testing.assert_array_equal(recording.depth, seen.depth)


@pytest.mark.parametrize(
    'stamp', [[0.0, 0.1, 0.1], np.array([7, 7, 9]) / 10, [0.0, 0.1, 0.2]], ids=str
)
def test_stamps_that_repeat_are_noticed(tmp_path, capsys, stamp):
    """Frames of one stamp have the same noise."""
    source = save(tmp_path, clean_depth=np.full((3, 9, 9), 1.0, np.float32), K=K, stamp=stamp)
    depth = simulate(source, tmp_path)['depth']
    count = len({image.tobytes() for image in depth})
    said = '1 of 3 frames have the stamp of another one, and so its noise'
    assert (said in ' '.join(capsys.readouterr().err.split())) == (count == 2)
    assert count == len(set(stamp))


def test_arrays_with_one_image_a_frame_are_cut_with_the_frames(tmp_path):
    scenes = np.stack([SCENE] * 5)
    known = np.isfinite(scenes)
    source = save(
        tmp_path,
        clean_depth=scenes,
        amplitude=np.ones(scenes.shape, np.uint16),
        known=known,
        clean_sigma=np.full(scenes.shape, 0.003, np.float32),
        uptime=np.arange(60.0, 65.0),
    )
    simulate(source, tmp_path, '--frames', '3')
    recording = load_recording(tmp_path / 'out.npz')
    assert recording.extra['uptime'] == 60.0
    assert recording.amplitude.shape == (3, *SCENE.shape)
    truth = read_truth(tmp_path / 'out.npz', recording.extra, recording.depth.shape)
    np.testing.assert_array_equal(truth.known, known[:3])


def test_more_frames_than_images_of_one_kind_are_refused(tmp_path, capsys):
    source = save(tmp_path, known=np.ones((5, *SCENE.shape), bool))
    assert main(['simulate', source, str(tmp_path / 'out.npz'), '--frames', '6']) == 2
    said = ' '.join(capsys.readouterr().err.split())
    assert 'known: must have an image for each of the 6 frames, got 5' in said
    assert not (tmp_path / 'out.npz').exists()
    simulate(source, tmp_path, '--frames', '5')
    recording = load_recording(tmp_path / 'out.npz')
    assert read_truth(tmp_path / 'out.npz', recording.extra, recording.depth.shape).known.all()


def test_the_input_may_be_a_recording(tmp_path):
    first = simulate(save(tmp_path), tmp_path)
    assert first['usecase'] == 'Mode_9_30fps'
    assert len(first['depth']) == 300
    recording = (tmp_path / 'out.npz').rename(tmp_path / 'recording.npz')
    again = simulate(str(recording), tmp_path, '--usecase', 'Mode_5_30fps')
    assert set(first) == set(again)
    assert str(again['usecase']) == 'Mode_5_30fps'
    np.testing.assert_array_equal(first['stamp'], again['stamp'])
    np.testing.assert_array_equal(again['clean_depth'], SCENE)
    assert not np.array_equal(first['depth'], again['depth'], equal_nan=True)


@pytest.mark.parametrize(
    ('arrays', 'options', 'parts'),
    [
        ({}, ['--usecase', 'Mode_9_31fps'], ['usecase', 'Mode_9_31fps', 'Mode_9_30fps']),
        ({}, ['--frames', '0'], ['--frames', 'must be', "got '0'"]),
        ({}, ['--seed', str(10**30)], ['--seed', 'must be', str(10**19)]),
        ({'clean_depth': np.stack([SCENE] * 3)}, ['--frames', '4'], ['--frames', '4', '3']),
        ({'stamp': np.empty(0)}, ['--frames', '5'], ['stamp', 'must be a time', 'got none']),
        ({'clean_depth': np.stack([SCENE] * 3), 'stamp': np.arange(2.0)}, [], ['stamp', '2', '3']),
        ({'K': np.zeros((3, 3))}, [], ['K', 'must be']),
    ],
    ids=str,
)
def test_bad_input(tmp_path, capsys, arrays, options, parts):
    source = save(tmp_path, **arrays)
    assert main(['simulate', source, str(tmp_path / 'out.npz'), *options]) == 2
    error = capsys.readouterr().err.lstrip()  # A progress bar may have been begun.
    assert error.startswith('flexx2: error: ')
    assert all(part in error for part in parts), error
    assert 'Traceback' not in error
    assert [path.name for path in tmp_path.iterdir()] == ['in.npz']


def test_wrong_arguments():
    for arguments in (['simulate'], ['nonsense'], []):
        assert main(arguments) == 2


@pytest.mark.parametrize('columns', ['80', '120'])
def test_modes(monkeypatch, capsys, columns):
    monkeypatch.setenv('COLUMNS', columns)
    assert main(['modes']) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    table = yaml.safe_load((ROOT / 'config' / 'modes.yaml').read_text())
    assert len(table['modes']) == 9
    for mode in flexx2().modes:
        line = next(line for line in lines if line.startswith(mode.name))
        row = table['modes'][mode.name]
        low, high = row['range_m']
        assert re.search(rf'{mode.name}\s+{row["rate_hz"]}\s+{low:g} - {high:g}', line)
        assert mode.measured or f'{mode.noise_of}*' in line
    for name, row in table['noise'].items():
        line = [line for line in lines if line.startswith(name)][-1]
        for key in 'abcd':
            assert f'{row[key]:.6f}' in line
            assert float(f'{row[key]:.6f}') == row[key]
        assert f'{row["sigma_x"]:.3f}' in line
        assert f' {row["n"]:g} ' in line
    assert '…' not in text

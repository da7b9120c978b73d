"""Folders as people have them: bags, damaged files, wrong keys, hardly any surface."""

from dataclasses import replace
import json

from bench.gap_campaigns import write_campaign
from campaigns import all_but, among, change, leaving, run_diagnose
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.data.campaign import check
from flexx2_sim_ros.gap.features.simulation import with_uptime
from flexx2_sim_ros.profiles.modes import flexx2
from made_bags import camera_entries, depths, SECOND, usecase, write
import numpy as np
import pytest

TINY = {'scale': 0.25, 'frames': 6, 'moving': 0}
NOISE_ALONE = among('excess_noise', 'heavy_tails', 'temporal_filter', 'pose_error')


def test_a_recording_without_a_mode_has_that_of_a_profile_of_one_mode(tmp_path):
    path = tmp_path / 'of_another_driver.npz'
    wall = np.full((48, 64), 1.5, np.float32)
    matrix = np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]])
    np.savez(path, depth=np.stack([wall] * 3), clean_depth=wall, K=matrix)
    refused = str(check(path, None))
    assert 'a mode of the Flexx2 (--profile names another camera)' in refused
    assert '--usecase MODE' in refused
    alone = replace(flexx2(), modes=flexx2().modes[:1])
    found = check(path, alone)
    assert found.mode == alone.modes[0]
    assert any('usecase: not in the file' in note for note in found.notes)


def test_bad_recordings_are_left_out_and_reported(tmp_path, capsys):
    folder = tmp_path / 'campaign'
    write_campaign(folder, seed=8, recordings=17, **TINY)
    files = sorted(folder.glob('*.npz'))
    with np.load(files[0]) as archive:
        depth, clean, stamp = archive['depth'], archive['clean_depth'], archive['stamp']
    left = np.arange(clean.shape[1]) < 28
    wrong = [
        ({'depth': np.full_like(depth, np.nan)}, 'depth'),
        ({'clean_depth': clean[:-3]}, 'clean_depth'),
        ({'clean_depth': np.stack([clean] * 4)}, 'clean_depth'),
        ({'stamp': np.where(np.arange(6) == 2, np.nan, stamp)}, 'stamp'),
        ({'stamp': stamp[:-1]}, 'stamp'),
        ({'usecase': np.array('Mode_5_30fps')}, 'usecase'),
        ({'usecase': np.array('Mode_7')}, 'Mode_7'),
        ({'clean_depth': np.full_like(clean, np.nan)}, 'clean_depth'),
        ({'clean_depth': None}, 'clean_depth'),
        (
            {'depth': np.where(left, np.nan, depth), 'clean_depth': np.where(left, clean, np.nan)},
            'must have pixels that are valid in both, got none',
        ),
        ({'distortion': np.full(5, np.nan)}, 'distortion'),
        ({'reflectivity': np.full(clean.shape, 1e6)}, 'reflectivity: must be 0 to 1'),
        ({'uptime': np.zeros(4)}, 'got float64 of shape (4,)'),
        ({'uptime': np.array(1.7e9)}, 'got 1.7e+09'),
        ({'K': np.eye(3) * np.nan}, 'K'),
    ]
    for file, (changes, _) in zip(files, wrong, strict=False):
        change(file, **changes)
    broken = folder / 'cut[off].npz'  # which rich would take for markup
    files[15].rename(broken)
    broken.write_bytes(broken.read_bytes()[:5000])
    wrong.append(({}, ''))
    files[15] = broken
    table = run_diagnose(folder, tmp_path / 'out', *leaving('pose_error'))
    said = ''.join(capsys.readouterr().err.split())
    assert 'cut[off].npz:cannotberead' in said
    reasons = {row['name']: row['reason'] for row in table['recordings'] if not row['used']}
    for file, (_, words) in zip(files, wrong, strict=False):
        assert file.name in reasons[file.name]
        assert words in reasons[file.name]
    assert [row['name'] for row in table['recordings'] if row['used']] == [files[16].name]


@pytest.mark.parametrize('kind', ['empty', 'absent', 'broken'])
def test_nothing_usable_is_an_error_and_writes_nothing(kind, tmp_path, capsys):
    folder = tmp_path / 'campaign'
    if kind != 'absent':
        folder.mkdir()
    if kind == 'broken':
        (folder / 'one.npz').write_bytes(b'PK no archive')
    assert main(['gap', 'diagnose', str(folder), '--out', str(tmp_path / 'out')]) == 2
    message = capsys.readouterr().err
    assert ('one.npz' if kind == 'broken' else str(folder)) in message
    assert not (tmp_path / 'out').exists()


def test_an_unwritable_output_is_refused_before_the_work(tmp_path, capsys):
    write_campaign(tmp_path / 'campaign', seed=1, recordings=1, **TINY)
    (tmp_path / 'file').write_text('')
    (tmp_path / 'taken' / 'effects.yaml').mkdir(parents=True)
    for out, words in (
        (tmp_path / 'file', 'a file'),
        (tmp_path / 'file' / 'in', 'not a directory'),
        (tmp_path / 'taken', 'got a folder'),
    ):
        began = []
        with pytest.raises(InputError, match=f'--out: .*{words}'):
            diagnose(
                tmp_path / 'campaign',
                out=out,
                progress=lambda text, share, began=began: began.append(text),
            )
        assert not began
        assert main(['gap', 'diagnose', str(tmp_path / 'campaign'), '--out', str(out)]) == 2
        assert '--out' in capsys.readouterr().err
    assert not list((tmp_path / 'taken' / 'effects.yaml').iterdir())


def test_a_bag_whose_mode_changes_is_left_out(tmp_path):
    write_campaign(tmp_path, seed=3, recordings=2, **TINY)
    entries = camera_entries('left', depths(6, 43, 56), depths(6, 43, 56))
    middle = SECOND + 3 * (SECOND // 60)
    entries.append(usecase('/left/flexx2_camera', middle + 1, 'Mode_9_30fps', changed=True))
    write(tmp_path / 'changes', sorted(entries, key=lambda entry: entry[2]))
    (tmp_path / 'nothing').mkdir()
    (tmp_path / 'nothing' / 'metadata.yaml').write_text('')
    rows = diagnose(tmp_path, **among('pose_error'))['recordings']
    reasons = {row['name']: row.get('reason') for row in rows if not row['used']}
    assert set(reasons) == {'changes', 'nothing'}
    assert 'usecase: Mode_9_30fps from about frame 4 on' in reasons['changes']


def test_a_recording_with_hardly_any_surface_is_harmless(tmp_path):
    write_campaign(
        tmp_path, seed=3, effects={'excess_noise': {'factor': 1.6}}, recordings=4, **TINY
    )
    path = min(tmp_path.glob('*.npz'))
    with np.load(path) as archive:
        clean = archive['clean_depth']
    few = np.full_like(clean, np.nan)
    few[20:31, 20:31] = 1.0
    change(path, clean_depth=few)
    table = diagnose(tmp_path, **NOISE_ALONE)
    assert sum(row['used'] for row in table['recordings']) == 4
    assert [row['name'] for row in table['effects']] == ['excess_noise']
    json.dumps(table, allow_nan=False)


def test_without_an_uptime_nothing_drifts():
    effects = {'warm_up_drift': {'bias': 0.01}, 'offset': {'bias': 0.01}}
    assert with_uptime(effects, None) == {'offset': {'bias': 0.01}}
    assert with_uptime(effects, 60.0)['warm_up_drift'] == {'bias': 0.01, 'uptime': 60.0}


def test_options_of_the_command_are_respected(tmp_path):
    # Scattered poses, which are what is usual here.
    write_campaign(tmp_path / 'campaign', seed=6, recordings=4, pose=(0.012, 0.7), **TINY)
    kept = 'amplitude_bias', 'wiggling', 'pose_error'
    options = '--seed', '4', '--pose-prior', '0.05', '3'
    table = run_diagnose(tmp_path / 'campaign', tmp_path / 'out', *leaving(*kept), *options)
    assert 'pose_error' not in {row['name'] for row in table['effects']}
    # Nor among what came nearest to explaining a gap.
    assert {row['name'] for row in table['effects'] + table['alternatives']} <= {*kept}
    assert [row['name'] for row in table['not_considered']] == all_but(*kept)
    assert max(abs(row['pose'][3]) for row in table['recordings']) > 1.0

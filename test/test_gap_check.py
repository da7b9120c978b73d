"""A diagnosis is checked on recordings that it has never seen, from files to files."""

from contextlib import redirect_stderr
from io import StringIO
import json
import os
import shutil

from bench.gap_campaigns import write_campaign
from campaigns import all_but, leaving, run_diagnose, write_diagnosis
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import load_effects, parse_effects, save_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import check, diagnose
from flexx2_sim_ros.gap.check import judged
from flexx2_sim_ros.gap.data.given import given_effects, together
from flexx2_sim_ros.gap.features.physical import UNITS
from flexx2_sim_ros.gap.inference.improvement import measured
import numpy as np
import pytest

SMALL = {'scale': 0.35, 'recordings': 5, 'frames': 8, 'moving': 0}
FEW = {**SMALL, 'recordings': 3}
KNOWN = {'offset': {'bias': 0.03}}
CAMERA = {**KNOWN, 'multipath': {}}


@pytest.fixture(scope='module')
def diagnosis(tmp_path_factory):
    """Diagnose a camera of which the offset is known; the campaign is kept beside it."""
    folder = tmp_path_factory.mktemp('diagnosed')
    write_campaign(folder / 'campaign', seed=101, effects=CAMERA, **SMALL)
    save_effects(folder / 'known.yaml', parse_effects(KNOWN))
    left_out = leaving('multipath', 'offset', 'amplitude_bias', 'pose_error')
    known = '--known', str(folder / 'known.yaml')
    run_diagnose(folder / 'campaign', folder / 'out', *known, *left_out)
    return folder / 'out'


@pytest.fixture(scope='module')
def fresh(tmp_path_factory):
    """Record other rooms with the same camera."""
    folder = tmp_path_factory.mktemp('fresh') / 'recordings'
    write_campaign(folder, seed=102, effects=CAMERA, **FEW)
    return folder


@pytest.fixture(scope='module')
def checked(diagnosis, fresh, tmp_path_factory):
    """Check the diagnosis; return the folder of what the command writes."""
    out = tmp_path_factory.mktemp('checked')
    command = ['gap', 'check', str(diagnosis), str(fresh), '--out', str(out), '--jobs', '1']
    with redirect_stderr(StringIO()) as said:
        assert main(command) == 0
    (out / 'said').write_text(said.getvalue())
    return out


def test_a_right_diagnosis_holds(checked):
    said = (checked / 'said').read_text()
    assert 'The diagnosis holds' in said
    assert 'nats' in said
    assert 'The gap is the difference between recordings and simulation: depth errors ' in said
    table = json.loads((checked / 'check.json').read_text())
    assert table['holds']
    assert table['reasons'] == []
    assert list(table['effects']) == ['multipath']
    loss = table['measures']['loss']
    assert loss['change'] < -1
    assert loss['shrink'] > 0.5
    assert max(loss['null'], loss['after']) < loss['before']
    assert not any(table['measures'][unit]['worse'] for unit in UNITS)
    assert table['measures']['wasserstein_mm']['change'] < 0
    for name in ('loss', *UNITS):
        one = table['measures'][name]
        for part in ('before', 'after', 'change'):
            low, high = one[f'{part}_interval']
            assert low <= one[part] <= high
        assert [len(row[name]) for row in table['recordings']] == [3, 3, 3]
    page = (checked / 'check.html').read_text()
    assert page.count('<svg') == 9 + 3 * 3
    assert 'nan' not in page.split('</style>')[1]


def test_a_wrong_diagnosis_does_not_hold(diagnosis, tmp_path, capsys):
    """Assert it on a camera with the known effect alone: what was diagnosed makes it worse."""
    write_campaign(tmp_path / 'fresh', seed=103, effects=KNOWN, **FEW)
    command = ['gap', 'check', str(diagnosis), str(tmp_path / 'fresh'), '--json', '--jobs', '1']
    assert main([*command, '--out', str(tmp_path / 'out')]) == 1
    table = json.loads(capsys.readouterr().out)
    assert not table['holds']
    assert table['measures']['loss']['change'] > 0
    assert table['measures']['wasserstein_mm']['change'] > 0
    assert table['reasons']
    assert table == json.loads((tmp_path / 'out' / 'check.json').read_text())


def test_recordings_of_the_diagnosis_are_refused(diagnosis, fresh, tmp_path, capsys):
    """Assert it for a recording under another name and with other ground truth."""
    used = diagnosis.parent / 'campaign' / 'scene_01.npz'
    mixed = tmp_path / 'mixed'
    shutil.copytree(fresh, mixed)
    with np.load(used) as content:
        changed = {**content, 'clean_depth': content['clean_depth'] + 0.001}
    np.savez_compressed(mixed / 'renamed.npz', **changed)
    out = tmp_path / 'out'
    command = ['gap', 'check', str(diagnosis), str(mixed), '--out', str(out), '--jobs', '1']
    assert main(command) == 2
    said = capsys.readouterr().err
    assert 'renamed.npz (there scene_01.npz)' in said
    # The others only have the names of recordings of the diagnosis.
    assert said.count('scene_') == 1
    assert not out.exists()


def test_a_camera_is_compared_at_the_noise_level_of_the_diagnosis(
    diagnosis, fresh, checked, tmp_path
):
    shutil.copytree(diagnosis, tmp_path / 'noisy')
    table = json.loads((diagnosis / 'diagnosis.json').read_text())
    table['gap']['noise_factor'] = 1.5
    (tmp_path / 'noisy' / 'diagnosis.json').write_text(json.dumps(table))
    right = json.loads((checked / 'check.json').read_text())
    wrong = check(tmp_path / 'noisy', fresh)
    after = [table['measures']['log_variance']['after'] for table in (right, wrong)]
    assert after[1] > after[0] + 0.5


def test_an_older_diagnosis_knows_its_recordings_by_name(diagnosis, fresh, tmp_path):
    shutil.copytree(diagnosis, tmp_path / 'old')
    table = json.loads((diagnosis / 'diagnosis.json').read_text())
    for row in table['recordings']:
        del row['checksum']
    del table['settings']
    (tmp_path / 'old' / 'diagnosis.json').write_text(json.dumps(table))
    with pytest.raises(InputError, match=r'scene_00\.npz \(by its name'):
        check(tmp_path / 'old', fresh)


@pytest.mark.parametrize(
    ('text', 'match'),
    [
        ('{', 'cannot be read'),
        ('[]', 'schema: must be 1'),
        ('{"schema": 3}', 'schema: must be 1 or 2, got 3'),
        ('{"schema": 1}', 'recordings: must be a list'),
        ('{"schema": 1, "recordings": [], "settings": {"pose_prior": [0]}}', 'pose_prior'),
        ('{"schema": 1, "recordings": [], "settings": {"full_scale": -1}}', 'full_scale'),
        ('{"schema": 1, "recordings": [], "settings": {"known": {"x": {}}}}', 'known: x: must be'),
        ('{"schema": 1, "recordings": [], "gap": {"noise_factor": 0}}', 'noise_factor: must be'),
        ('{"schema": 1, "recordings": [], "verdict": "none"}', 'effects to check, got none'),
    ],
)
def test_what_is_no_diagnosis_is_refused(text, match, fresh, tmp_path):
    (tmp_path / 'diagnosis.json').write_text(text)
    (tmp_path / 'effects.yaml').write_text('schema: 1\neffects: {}\n')
    with pytest.raises(InputError, match=match):
        check(tmp_path, fresh, out=tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def test_a_folder_without_a_diagnosis_or_with_a_pipe_is_refused(fresh, tmp_path):
    with pytest.raises(InputError, match='DIAGNOSIS: must be a folder that flexx2 gap diagnose'):
        check(tmp_path, fresh)
    os.mkfifo(tmp_path / 'diagnosis.json')
    with pytest.raises(InputError, match='diagnosis.json: must be an ordinary file'):
        check(tmp_path, fresh)


def test_effects_taken_as_given_leave_the_rest(diagnosis, fresh):
    """Assert that a known offset of 3 cm hides nothing, and is not reported."""
    table = json.loads((diagnosis / 'diagnosis.json').read_text())
    assert table['verdict'] == 'identified'
    assert [row['name'] for row in table['effects']] == ['multipath']
    assert table['settings']['known']['offset']['bias'] == 0.03
    assert {'name': 'offset', 'reason': 'taken as given'} in table['not_considered']
    assert [effect.name for effect in load_effects(diagnosis / 'effects.yaml')] == ['multipath']
    # The check takes the same as given, unless it is told otherwise.
    without = check(diagnosis, fresh, known={})
    assert without['measures']['loss']['after'] > 2 * without['measures']['loss']['null']
    with pytest.raises(InputError, match='looked for as well, got multipath'):
        check(diagnosis, fresh, known={'multipath': {}})


CURVES = {
    'offset': {'curve': {'knots': [0.5, 3.0], 'values': [-0.02, 0.04]}},
    'excess_noise': {'slant': {'knots': [20.0, 60.0], 'values': [2.5, 1.0]}},
}


def test_a_number_acts_on_top_of_a_given_curve():
    clean, K = np.full((40, 50), 1.5, np.float32), np.array([[50, 0, 25], [0, 50, 20], [0, 0, 1]])

    def seen(*effects):
        return Camera(effects=effects, seed=1).capture(clean, K, 0.0).depth

    given = given_effects(CURVES)
    plain, offset, noise = (
        seen(*together(given, more))
        for more in ({}, {'offset': {'bias': 0.003}}, {'excess_noise': {'factor': 1.5}})
    )
    assert not np.array_equal(plain, seen())
    np.testing.assert_allclose(offset - plain, 0.003, atol=1e-6)
    silent = plain - seen(*given_effects({'offset': CURVES['offset']}))
    assert np.corrcoef((noise - plain).ravel(), silent.ravel())[0, 1] > 0.9
    np.testing.assert_array_equal(seen(*together((), parse_effects(CURVES))), plain)


def test_what_cannot_be_given_is_refused(tmp_path):
    folder = write_diagnosis(tmp_path / 'diagnosis', {'offset': {'bias': 0.02}})
    with pytest.raises(InputError, match='one of them has a curve, got offset'):
        check(folder, tmp_path, known=CURVES)
    with pytest.raises(InputError, match='known: must be effects of the camera, got pose_error'):
        diagnose(tmp_path, known={'pose_error': {}})


def test_a_given_delay_leaves_the_latency_to_be_found(tmp_path):
    """Assert it of what `effects.yaml` of bags has: when images arrive changes none of them."""
    moving = {'recordings': 4, 'frames': 8, 'scale': 0.35, 'moving': 4}
    camera = {'time_offset': {'latency': 0.08}}
    write_campaign(tmp_path / 'bags', seed=103, effects=camera, **moving)
    known = {'time_offset': {'latency': 0.0, 'delay': 0.05}}
    left_out = all_but('time_offset', 'pose_error')
    out = tmp_path / 'out'
    table = diagnose(tmp_path / 'bags', known=known, without=left_out, out=out)
    (found,) = table['effects']
    assert found['name'] == 'time_offset'
    assert found['parameters']['latency'] == pytest.approx(0.08, abs=0.01)
    assert 'time_offset' not in [row['name'] for row in table['not_considered']]
    assert table['settings']['known'] == known | {
        'time_offset': {'strength': 1.0, **known['time_offset']}
    }
    two = {**moving, 'recordings': 2, 'moving': 2}
    write_campaign(tmp_path / 'fresh', seed=104, effects=camera, **two)
    assert check(out, tmp_path / 'fresh', known=known)['holds']


def test_only_a_change_that_is_significant_and_matters_counts():
    none = np.zeros(4)
    scattered = np.array([[1.0, 2.0, 0.1], [2.0, 1.0, 0.1], [1.0, 1.5, 0.1], [2.0, 1.6, 0.1]])
    small = np.stack([none + 1, none + 1.01 + 0.001 * np.arange(4), none], axis=1)
    large = np.stack([none + 1, none + 1.5 + 0.001 * np.arange(4), none], axis=1)
    better = np.stack([none + 1, none + 0.5 + 0.001 * np.arange(4), none], axis=1)
    results = [measured(values, 0.1) for values in (scattered, small, large, better)]
    assert [one['worse'] for one in results] == [False, False, True, False]
    assert [one['better'] for one in results] == [False, False, False, True]
    results[3]['tolerance'] = 0.4
    good = {'loss': results[3], **dict.fromkeys(UNITS, results[1])}
    assert judged(good) == (True, [])
    holds, reasons = judged({**good, 'kl_nats': results[2]})
    assert not holds
    assert reasons == ['kl_nats gets significantly worse: 1 to 1.5.']
    single = measured(better[:1], 0.1)
    assert single['better']
    assert single['change_interval'] is None

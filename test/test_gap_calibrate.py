"""Diagnosed effects get the form that recordings show, from files to files."""

from dataclasses import replace
import json
from pathlib import Path

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import load_effects, parse_effects, registry, save_effects
from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import calibrate, diagnose, measure, randomise
from flexx2_sim_ros.gap.cost import known_of
from flexx2_sim_ros.gap.data.campaign import check, Found, read
from flexx2_sim_ros.gap.forms.bias import forms_of
from flexx2_sim_ros.gap.forms.fitting import BiasFit, own_motion
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.gap.forms.work import registered
from flexx2_sim_ros.gap.report.reading import read_diagnosis
import numpy as np
import pytest
from study.benchmark import DEVELOPMENT
from study.benchmark.design import Planned
from study.benchmark.realised import realised_gap
from study.blind import BlindCamera

SMALL = {'recordings': 5, 'frames': 6, 'scale': 0.5, 'moving': 1}
SHAPE = (86, 112)
# A camera that differs from the effects' formulas: a wave of another length, columns, a table
# with a ceiling.
RANGES = np.linspace(0.0, 6.0, 121)
WAVE = 0.008 * np.sin(2 * np.pi * RANGES / 1.7)
COLUMNS = 0.003 * np.broadcast_to((-1.0) ** (np.arange(SHAPE[1]) // 2), SHAPE)
CAMERA = {
    'wiggling': {'curve': {'knots': RANGES.tolist(), 'values': WAVE.tolist()}},
    'fixed_pattern': {'pattern': COLUMNS.copy()},
    'grazing_dropout': {'curve': {'knots': [40.0, 60.0], 'values': [0.0, 0.5]}},
}
DIAGNOSED = {
    'wiggling': {'a4': 0.004},
    'fixed_pattern': {'rms': 0.002},
    'grazing_dropout': {'half_deg': 64.0},
    'quantisation': {'step': 0.001},
}


def write_diagnosis(folder: Path, effects: dict, alternatives: dict | None = None) -> Path:
    """Write what `flexx2 gap calibrate` reads of a diagnosis."""
    folder.mkdir(exist_ok=True)
    rows = [
        {'name': name, 'parameters': values, 'instead_of': list(effects)}
        for name, values in (alternatives or {}).items()
    ]
    table = {
        'schema': 1,
        'verdict': 'unknown' if rows else 'identified',
        'recordings': [],
        'alternatives': rows,
    }
    (folder / 'diagnosis.json').write_text(json.dumps(table))
    save_effects(folder / 'effects.yaml', parse_effects(effects))
    return folder


@pytest.fixture(scope='module')
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record rooms with a camera whose effects have forms of their own."""
    folder = tmp_path_factory.mktemp('campaign') / 'recordings'
    write_campaign(folder, seed=111, effects=CAMERA, **SMALL)
    return folder


def test_forms_are_found_and_taken(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    diagnosis, out = write_diagnosis(tmp_path / 'diagnosis', DIAGNOSED), tmp_path / 'out'
    command = ['gap', 'calibrate', str(diagnosis), str(campaign), '--out', str(out)]
    assert main([*command, '--jobs', '1']) == 0
    assert 'Calibrated: wiggling, fixed pattern, grazing dropout.' in capsys.readouterr().err
    assert sorted(path.name for path in out.iterdir()) == [
        'calibration.html',
        'calibration.json',
        'diagnosis.json',
        'effects.yaml',
        'fixed_pattern.npz',
    ]
    table = json.loads((out / 'calibration.json').read_text())
    assert [row['name'] for row in table['effects']] == [
        'wiggling',
        'fixed_pattern',
        'grazing_dropout',
    ]
    for row in table['effects']:
        assert row['taken']
        assert row['after'] < row['before']
    assert table['unchanged'] == ['quantisation']
    effects = {one.name: one for one in load_effects(out / 'effects.yaml')}
    # A wave is known but for a constant, which a pose error looks like.
    seen = (RANGES > 1.2) & (RANGES < 3.0)
    missed = effects['wiggling'].curve.at(RANGES)[seen] - WAVE[seen]
    assert missed.std() < 0.3 * WAVE[seen].std()
    pattern = effects['fixed_pattern'].pattern.values
    # As strong as the camera's; where little is known of a pixel, drawn at random.
    assert np.corrcoef(pattern.ravel(), COLUMNS.ravel())[0, 1] > 0.6
    assert pattern.std() == pytest.approx(COLUMNS.std(), rel=0.2)
    assert effects['quantisation'].step == 0.001
    page = (out / 'calibration.html').read_text()
    assert page.count('class="band"') == 2
    assert page.count('<img') == 1
    assert 'nan' not in page.split('</style>')[1].replace('base64', '').split('src="')[0]


def test_a_calibration_in_a_folder_of_its_own_can_be_checked(tmp_path: Path) -> None:
    wrong = {'offset': {'bias': 0.02}}
    write_campaign(tmp_path / 'campaign', seed=116, effects=wrong, **TINY)
    write_campaign(tmp_path / 'fresh', seed=117, effects=wrong, **TINY)
    diagnose(tmp_path / 'campaign', out=tmp_path / 'diagnosis')
    before = (tmp_path / 'diagnosis' / 'diagnosis.json').read_bytes()
    calibrate(tmp_path / 'diagnosis', tmp_path / 'campaign', out=tmp_path / 'out')
    assert main(['gap', 'check', str(tmp_path / 'out'), str(tmp_path / 'fresh')]) == 0
    # The recordings of the diagnosis are known.
    assert len(read_diagnosis(tmp_path / 'out').checksums) == TINY['recordings']
    assert (tmp_path / 'diagnosis' / 'diagnosis.json').read_bytes() == before


@pytest.mark.parametrize('mix', [0.4, 1.0])
@pytest.mark.parametrize('out', ['diagnosis', 'out'])
def test_effects_without_a_recording_are_dropped_with_a_new_form(
    out: str, mix: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Assert it also of the diagnosis's own folder: a cost would be that of the old effects."""
    filtered = {'spatial_filter': {'mix': mix}}
    write_campaign(tmp_path / 'recordings', seed=119, effects=filtered, **TINY)
    typical = {'spatial_filter': {'mix': 0.4}}
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', typical)
    file = diagnosis / 'diagnosis.json'
    rows = [
        {'name': f'{one}.npz', 'used': True, 'checksum': one, 'effects_without': typical}
        for one in '12'
    ]
    file.write_text(json.dumps({**json.loads(file.read_text()), 'recordings': rows}))
    table = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / out)
    assert table['effects'][0]['taken'] == (mix != 0.4)
    after = read_diagnosis(tmp_path / out)
    assert {'1', '2'} <= after.checksums.keys()
    assert len(after.checksums) == (2 if mix == 0.4 else 2 + TINY['recordings'])
    if mix != 0.4:  # no check may use what the form was fitted to
        arguments = ['gap', 'check', str(tmp_path / out), str(tmp_path / 'recordings')]
        assert main(arguments) == 2
        assert 'must be recordings that the diagnosis has not seen' in capsys.readouterr().err
    assert known_of(after).without.keys() == ({'1', '2'} if mix == 0.4 else set())
    # The effects of a single recording were fitted to it.
    alone = {**after.table, 'recordings': rows[:1]}
    assert known_of(replace(after, table=alone)).without == {}


def test_a_diagnosis_has_the_form_of_the_camera(tmp_path: Path) -> None:
    """Assert that its effects take most of the gap to a camera of another kind in new scenes."""
    size = {'recordings': 4, 'frames': 8, 'width': 80, 'height': 61}
    mode, seeds = 'Mode_9_30fps', (DEVELOPMENT.seed(1001), DEVELOPMENT.seed(1))
    planned = Planned('single', mode, {'wiggling': 1.0}, *seeds, pose_mm=2.0, **size)
    recordings, out, cache = (tmp_path / name for name in ('recordings', 'out', 'cache'))
    recordings.mkdir()
    BlindCamera(planned.case).record(recordings)
    table = diagnose(recordings, out=out)
    plain = diagnose(recordings, out=tmp_path / 'plain', calibrate=False)
    (row,) = table['calibration']['effects']
    assert row['taken']
    assert row['typical'] == plain['effects'][0]['parameters']
    assert plain['calibration'] is None
    assert table['calibration']['typical_gap']['shrink'] == plain['gap']['shrink']
    # What is decided is the same, but for the verdict: it counts what the effects take off, too.
    for key in ('alternatives', 'where', 'unexplained', 'evidence'):
        assert table[key] == plain[key]
    for one, other in zip(table['effects'], plain['effects'], strict=True):
        assert {**one, 'parameters': {}} == {**other, 'parameters': {}}
    # effects.yaml has what the table has, and works in new scenes.
    effects = load_effects(out / 'effects.yaml')
    assert effects == parse_effects({one['name']: one['parameters'] for one in table['effects']})
    realised = [realised_gap(planned, one, cache, measure)['shrink'] for one in (table, plain)]
    assert realised[0] > max(0.7, realised[1])
    # Four recordings leave open how large a wave is: less is promised than happens.
    low, high = table['gap']['interval']
    assert low < 0.5 < table['gap']['shrink'] < realised[0] <= high
    assert 'Calibrated: wiggling' in (out / 'report.html').read_text()
    # Later steps read it: distributions, and the forms without each recording.
    assert 'wiggling' in randomise(out).named
    without = known_of(read_diagnosis(out)).without
    assert len(without) == 4
    assert all(isinstance(one['wiggling']['curve'], Curve) for one in without.values())


def test_a_diagnosis_carries_a_map(campaign: Path, tmp_path: Path) -> None:
    """Assert it of the file beside effects.yaml, and of the table, which JSON can hold."""
    out = tmp_path / 'out'
    table = diagnose(campaign, out=out)
    forms = {row['name']: row['taken'] for row in table['calibration']['effects']}
    assert forms['fixed_pattern']
    json.dumps(table, allow_nan=False)
    found = {one['name']: one['parameters'] for one in table['effects']}
    effects = {one.name: one for one in load_effects(out / 'effects.yaml')}
    assert effects['fixed_pattern'].pattern.values.tolist() == found['fixed_pattern']['pattern']
    written = json.loads((out / 'diagnosis.json').read_text())
    (row,) = (one for one in written['effects'] if one['name'] == 'fixed_pattern')
    assert row['parameters']['pattern'] == 'fixed_pattern.npz'


def test_late_images_keep_their_delay_where_another_effect_gets_a_curve(tmp_path: Path) -> None:
    grazing = {'curve': {'knots': [40.0, 60.0], 'values': [0.0, 0.5]}}
    camera = {'time_offset': {'latency': 0.08}, 'grazing_dropout': grazing}
    size = {'recordings': 4, 'frames': 8, 'scale': 0.35, 'moving': 3}
    recordings, out = tmp_path / 'recordings', tmp_path / 'out'
    write_campaign(recordings, seed=45, effects=camera, **size)
    for path in recordings.iterdir():
        with np.load(path) as archive:
            content = dict(archive)
        np.savez(path, **content, received=content['stamp'] + 0.05)
    left_out = [name for name in registry() if name not in (*camera, 'pose_error')]
    table = diagnose(recordings, out=out, without=left_out)
    (row,) = table['calibration']['effects']
    assert row['taken']
    found = {one['name']: one['parameters'] for one in table['effects']}
    assert found['time_offset']['delay'] == pytest.approx(0.05)
    assert load_effects(out / 'effects.yaml') == parse_effects(found)


def test_noise_that_depends_on_the_incidence_gets_a_curve(tmp_path: Path) -> None:
    """Assert it of surfaces that add noise of their own, which does not grow with the rest."""
    slant = {'knots': [20.0, 60.0], 'values': [1.8, 1.0]}
    camera = {'excess_noise': {'slant': slant}}
    write_campaign(tmp_path / 'recordings', seed=113, effects=camera, **SMALL)
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'excess_noise': {'factor': 1.5}})
    (row,) = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / 'out')['effects']
    assert row['taken']
    assert row['after'] < 0.7 * row['before']
    effects = {one.name: one for one in load_effects(tmp_path / 'out' / 'effects.yaml')}
    found = effects['excess_noise'].slant.at([15.0, 40.0, 65.0])
    np.testing.assert_allclose(found, [1.8, 1.4, 1.0], rtol=0.1)
    assert 'excess noise: factor on sigma_z' in (tmp_path / 'out' / 'calibration.html').read_text()


def test_a_form_that_is_no_better_is_not_taken(tmp_path: Path) -> None:
    """Assert it of a camera that is as it was diagnosed."""
    right = {'offset': {'bias': 0.01}, 'low_signal_dropout': {'half': 0.1}}
    exact = {'pose': (0.0, 0.0), 'reflectivity': 0.0}
    write_campaign(tmp_path / 'recordings', seed=112, effects=right, **SMALL, **exact)
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', right)
    table = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / 'out')
    assert [row['taken'] for row in table['effects']] == [False, False]
    assert load_effects(tmp_path / 'out' / 'effects.yaml') == parse_effects(right)


def test_what_cannot_be_calibrated_is_named(campaign: Path, tmp_path: Path) -> None:
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'offset': {}})
    few = tmp_path / 'few'
    few.mkdir()
    for path in sorted(campaign.iterdir())[:2]:
        (few / path.name).symlink_to(path)
    with pytest.raises(InputError, match='at least 3 recordings.*got 2'):
        calibrate(diagnosis, few)
    with pytest.raises(InputError, match='DIAGNOSIS: must be a folder'):
        calibrate(tmp_path / 'nowhere', campaign)


def test_a_map_needs_images_of_one_size(campaign: Path, tmp_path: Path) -> None:
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'fixed_pattern': {}})
    mixed = tmp_path / 'mixed'
    write_campaign(mixed, seed=113, effects={}, **{**SMALL, 'recordings': 1, 'scale': 0.25})
    for path in sorted(campaign.iterdir())[:2]:
        (mixed / f'large_{path.name}').symlink_to(path)
    with pytest.raises(InputError, match='images of one size, .* got 56 x 43 and 112 x 86'):
        calibrate(diagnosis, mixed)
    # As an alternative it is not tried.
    diagnosis = write_diagnosis(
        tmp_path / 'other', {'quantisation': {'step': 0.001}}, {'fixed_pattern': {}}
    )
    table = calibrate(diagnosis, mixed)
    assert [row['effects'] for row in table['explanations']] == [['quantisation']]


TINY = {'recordings': 4, 'frames': 6, 'scale': 0.25, 'moving': 0}


@pytest.mark.parametrize(
    'effects',
    [
        {'time_offset': {'latency': 0.16}},
        {'wiggling': {'mhz': 100.0, 'a2': 0.012, 'a4': 0.0}},
        {'temporal_filter': {'share': 0.8}},
    ],
)
def test_the_pose_with_effects_is_the_true_one(effects: dict, tmp_path: Path) -> None:
    """Assert it for late images, a wave and a filter, of cameras whose given pose is exact."""
    size = {**TINY, 'recordings': 2, 'moving': 2}
    write_campaign(tmp_path, seed=120, effects=effects, pose=(0.0, 0.0), **size)
    prior = np.array([0.005] * 3 + [0.3] * 3)
    for path in sorted(tmp_path.iterdir()):
        found = check(path, None)
        assert isinstance(found, Found)
        motion, _, _ = registered(read(found, None), prior, effects)
        assert np.linalg.norm(motion / prior) < 2.5


def test_parameters_are_found_by_simulation(tmp_path: Path) -> None:
    """Assert it of a filter with another kernel than the diagnosed one."""
    filtered = {'spatial_filter': {'width': 1.0, 'mix': 1.0, 'gate': 8.0}}
    write_campaign(tmp_path / 'recordings', seed=114, effects=filtered, **TINY)
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'spatial_filter': {'mix': 0.4}})
    table = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / 'out')
    (row,) = table['effects']
    assert row['taken']
    assert row['after'] < row['before']
    assert table['gap']['shrink'] > 0.8
    (effect,) = load_effects(tmp_path / 'out' / 'effects.yaml')
    assert effect.width == pytest.approx(1.0, rel=0.3)


def test_a_filter_over_frames_gets_its_own_kernel(tmp_path: Path) -> None:
    """Assert that a mean of four frames is not taken for a recursive filter."""
    filtered = {'temporal_filter': {'window': 4.0, 'gate': 100.0}}
    write_campaign(tmp_path / 'recordings', seed=117, effects=filtered, **{**TINY, 'frames': 12})
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'temporal_filter': {'share': 0.6}})
    table = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / 'out')
    (row,) = table['effects']
    assert row['taken']
    assert row['form'] == 'mean of frames'
    (effect,) = load_effects(tmp_path / 'out' / 'effects.yaml')
    assert effect.window == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize(
    ('name', 'camera', 'diagnosed', 'label'),
    [
        (
            'grazing_dropout',
            {'curve': {'knots': [40.0, 60.0], 'values': [0.0, 0.5]}},
            {'slant': {'knots': [-1.0, 1.0], 'values': [0.3, 0.0]}},
            'monotone table over incidence',
        ),
        ('flying_pixels', {'footprint': 2.0}, {'footprint': 1.0, 'mhz': 15.0}, 'square'),
        (
            'temporal_filter',
            {'share': 0.8, 'gate': 100.0},
            {'window': 2.0, 'gate': 1.0},
            'weight and gate',
        ),
    ],
)
def test_a_new_form_replaces_the_one_that_an_effect_has(
    name: str, camera: dict, diagnosed: dict, label: str, tmp_path: Path
) -> None:
    """Assert it of forms that win over the new one where an effect has both."""
    write_campaign(tmp_path / 'recordings', seed=118, effects={name: camera}, **SMALL)
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {name: diagnosed})
    table = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / 'out')
    (row,) = table['effects']
    assert row['taken']
    assert row['form'] == label
    assert table['gap']['shrink'] > 0.6
    (effect,) = load_effects(tmp_path / 'out' / 'effects.yaml')
    assert not effect.forms.keys() & (diagnosed.keys() - camera.keys())


def test_an_alternative_is_calibrated_where_the_diagnosis_leaves_one(tmp_path: Path) -> None:
    """Assert the right one of two explanations is taken; a bad recording is named and left out."""
    recordings = tmp_path / 'recordings'
    filtered = {'spatial_filter': {'width': 1.0, 'mix': 1.0, 'gate': 8.0}}
    write_campaign(recordings, seed=115, effects=filtered, **TINY)
    first = sorted(recordings.iterdir())[0]
    with np.load(first) as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(recordings / 'bad.npz', **{**arrays, 'clean_depth': np.ones((5, 4), np.float32)})
    diagnosis = write_diagnosis(
        tmp_path / 'diagnosis', {'quantisation': {'step': 0.001}}, {'spatial_filter': {'mix': 0.4}}
    )
    table = calibrate(diagnosis, recordings, out=tmp_path / 'out')
    assert [row['effects'] for row in table['explanations']] == [
        ['quantisation'],
        ['spatial_filter'],
    ]
    assert [row['chosen'] for row in table['explanations']] == [False, True]
    (left_out,) = table['left_out']
    assert left_out['name'] == 'bad.npz'
    assert 'clean_depth: must have the size' in left_out['reason']
    names = {one.name for one in load_effects(tmp_path / 'out' / 'effects.yaml')}
    assert 'spatial_filter' in names
    assert 'quantisation' not in names


def test_a_rest_without_a_cause_is_carried_along_as_a_correction(tmp_path: Path) -> None:
    """Assert it of a bias over amplitude, and that the file says what it is."""
    waves = {'knots': [-3.0, -2.0, -1.0, 0.0, 1.0], 'values': [0.02, -0.02, 0.02, -0.02, 0.02]}
    camera = {'amplitude_bias': {'curve': waves}}
    size = {**TINY, 'recordings': 6, 'scale': 0.5}
    write_campaign(tmp_path / 'recordings', seed=116, effects=camera, pose=(0.0, 0.0), **size)
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'quantisation': {'step': 0.0005}})
    table = calibrate(diagnosis, tmp_path / 'recordings', out=tmp_path / 'out')
    assert table['empirical']['taken'], table['empirical']
    assert table['empirical']['form'] == 'log_amplitude'
    assert table['empirical']['after'] < table['empirical']['before']
    text = (tmp_path / 'out' / 'effects.yaml').read_text()
    assert 'Empirical correction over log amplitude, without a cause' in text
    assert 'its cause is not known' in (tmp_path / 'out' / 'calibration.html').read_text()


def test_a_recording_without_valid_pixels_stays_where_it_was_registered() -> None:
    """Assert it of pose and forms: what the others say is not changed."""
    nothing = np.zeros(0)
    dark = Samples(
        np.ones(6), nothing, nothing, np.zeros((6, 0)), np.eye(6), *[nothing] * 5,
        np.zeros(0, int),
    )  # fmt: skip
    assert own_motion(dark, nothing, np.full(6, 0.5)) == pytest.approx(np.full(6, 0.5))
    ramp = np.linspace(1.0, 3.0, 50)
    bright = Samples(
        np.zeros(6), np.full(50, 0.01), np.full(50, 1e-3), np.zeros((6, 50)), np.eye(6),
        np.ones(50), ramp, -ramp, ramp, ramp, np.arange(50),
    )  # fmt: skip
    form = forms_of('offset', flexx2().mode('Mode_9_30fps'))[0][0]
    fitted = BiasFit([bright, dark, bright]).fit([form])
    assert fitted.together == pytest.approx([0.01], rel=1e-2)


def test_a_curve_repeats_with_its_period() -> None:
    curve = Curve((0.0, 0.5), (0.0, 1.0), 1.0)
    assert curve.at([0.25, 1.25, 0.75]).tolist() == [0.5, 0.5, 0.5]
    assert Curve((0.0, 0.5), (0.0, 1.0)).at([-1.0, 0.25, 9.0]).tolist() == [0.0, 0.5, 1.0]


def test_a_correction_that_is_taken_as_given_is_not_fitted_again(
    campaign: Path, tmp_path: Path
) -> None:
    diagnosis = write_diagnosis(tmp_path / 'diagnosis', {'excess_noise': {'factor': 1.1}})
    path = diagnosis / 'diagnosis.json'
    settings = {'known': {'residual_patch': {'bias_0': 0.01}}}
    path.write_text(json.dumps({**json.loads(path.read_text()), 'settings': settings}))
    assert calibrate(diagnosis, campaign)['empirical'] is None

"""Diagnosed effects get the form that recordings show; the lens is fitted with the poses."""

import json
import shutil

from bench.gap_campaigns import write_campaign
from campaigns import all_but, change, leaving, run_diagnose
from flexx2_sim_ros.effects import load_effects, parse_effects
from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose, measure, randomise
from flexx2_sim_ros.gap.cost import known_of
from flexx2_sim_ros.gap.data.campaign import read
from flexx2_sim_ros.gap.data.registration import register
from flexx2_sim_ros.gap.features.work import find, Simulator
from flexx2_sim_ros.gap.forms.calibrating import calibrate_named
from flexx2_sim_ros.gap.forms.looked import look, look_again
from flexx2_sim_ros.gap.report.charts import forms
from flexx2_sim_ros.gap.report.reading import read_diagnosis
from flexx2_sim_ros.jobs import workers
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
DEAD = np.zeros(SHAPE)
DEAD[:12, :16] = DEAD[40, ::3] = 1.0
DIAGNOSED = {
    'wiggling': {'a4': 0.004},
    'fixed_pattern': {'rms': 0.002},
    'grazing_dropout': {'half_deg': 64.0},
    'quantisation': {'step': 0.001},
}


PRIOR = (0.01,) * 3 + (0.5,) * 3


def fitted_forms(recordings, named, quick=False):
    """Return the forms that a diagnosis with these effects would fit."""
    effects = parse_effects(named)
    with workers(1, None) as mapped:
        found, _ = find(recordings, None, mapped)
        motions = [register(read(one, None), np.array(PRIOR))[0] for one in found]
        return calibrate_named(
            found,
            motions,
            effects,
            [effects] * len(found),
            Simulator(mapped, None, {}, 0, PRIOR),
            lambda: None,
            quick,
        )


def test_dead_pixels_are_found(tmp_path):
    """A corner and a row that never return, beside losses at random."""
    lost = np.where(DEAD, 1.0, 0.05)
    write_campaign(tmp_path, seed=112, effects={'random_dropout': {'dead': lost}}, **SMALL)
    found = fitted_forms(tmp_path, {'random_dropout': {'share': 0.08}})
    (verdict,) = found.explained.verdicts
    assert verdict.taken
    (effect,) = found.effects(parse_effects({'random_dropout': {}}))
    np.testing.assert_array_equal(effect.dead.values > 0.5, DEAD > 0)
    assert np.median(effect.dead.values) == pytest.approx(0.05, abs=0.01)
    page = forms(found.explained.verdicts, found.explained.looked)
    assert 'red is always lost' in page


@pytest.fixture(scope='module')
def campaign(tmp_path_factory):
    """Record rooms with a camera whose effects have forms of their own."""
    folder = tmp_path_factory.mktemp('campaign') / 'recordings'
    write_campaign(folder, seed=111, effects=CAMERA, **SMALL)
    return folder


def test_forms_are_found_and_taken(campaign):
    found = fitted_forms(campaign, DIAGNOSED)
    verdicts = {one.proposal.effect: one for one in found.explained.verdicts}
    assert list(verdicts) == ['wiggling', 'fixed_pattern', 'grazing_dropout']
    for one in verdicts.values():
        assert one.taken
        assert one.after.mean() < one.before.mean()
    effects = {one.name: one for one in found.effects(parse_effects(DIAGNOSED))}
    # A wave is known but for a constant, which a pose error looks like.
    seen = (RANGES > 1.2) & (RANGES < 3.0)
    missed = effects['wiggling'].curve.at(RANGES)[seen] - WAVE[seen]
    assert missed.std() < 0.3 * WAVE[seen].std()
    pattern = effects['fixed_pattern'].pattern.values
    # As strong as the camera's; where little is known of a pixel, drawn at random.
    assert np.corrcoef(pattern.ravel(), COLUMNS.ravel())[0, 1] > 0.6
    assert pattern.std() == pytest.approx(COLUMNS.std(), rel=0.2)
    assert effects['quantisation'].step == 0.001
    page = forms(found.explained.verdicts, found.explained.looked)
    assert page.count('class="band"') == 2
    assert page.count('<img') == 1
    assert 'nan' not in page.replace('base64', '').split('src="')[0]


def test_a_diagnosis_has_the_form_of_the_camera(tmp_path):
    """Assert that its effects take most of the gap to a camera of another kind in new scenes."""
    size = {'recordings': 4, 'frames': 8, 'width': 80, 'height': 61}
    mode, seeds = 'Mode_9_30fps', (DEVELOPMENT.seed(1001), DEVELOPMENT.seed(1))
    planned = Planned('single', mode, {'wiggling': 1.0}, *seeds, pose_mm=2.0, **size)
    recordings, out, cache = (tmp_path / name for name in ('recordings', 'out', 'cache'))
    recordings.mkdir()
    BlindCamera(planned.case).record(recordings)
    left_out = all_but('wiggling', 'offset', 'amplitude_bias', 'pose_error')
    table = diagnose(recordings, out=out, without=left_out)
    plain = diagnose(recordings, forms='catalogue', without=left_out)
    (row,) = table['calibration']['effects']
    assert row['taken']
    assert row['typical'] == plain['effects'][0]['parameters']
    assert plain['calibration'] is None
    assert table['calibration']['typical_gap']['shrink'] == plain['gap']['shrink']
    # What is decided is the same, but for the verdict: it counts what the effects take off, too.
    for key in ('alternatives', 'where', 'unexplained', 'evidence'):
        assert table[key] == plain[key]
    for one, other in zip(table['effects'], plain['effects'], strict=True):
        # What an effect takes off, it does with its form.
        assert [one[key] for key in ('name', 'confidence')] == [other['name'], other['confidence']]
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


def test_a_wide_filter_hides_no_other_effect(tmp_path):
    """Assert that lost pixels and a drift behind it are found: by how much depth a pixel spans."""
    camera = {
        'spatial_filter': {'mix': 1.0, 'width': 2.5, 'gate': 20.0},
        'warm_up_drift': {'bias': 0.02},
        'grazing_dropout': {'slant': {'knots': [1.0, 2.0], 'values': [0.0, 0.9]}},
    }
    write_campaign(tmp_path, seed=7, effects=camera, **{**SMALL, 'scale': 0.25})
    others = 'flying_pixels', 'lateral_noise', 'low_signal_dropout', 'pose_error'
    table = diagnose(tmp_path, without=all_but(*camera, *others))
    assert {one['name'] for one in table['effects']} == set(camera)
    assert table['gap']['shrink'] > 0.9


def test_a_diagnosis_carries_a_map(tmp_path):
    """Assert it of the file beside effects.yaml, and of the table, which JSON can hold."""
    campaign, out = tmp_path / 'campaign', tmp_path / 'out'
    camera = {'fixed_pattern': CAMERA['fixed_pattern']}
    write_campaign(campaign, seed=111, effects=camera, **{**SMALL, 'recordings': 4})
    table = diagnose(campaign, out=out, without=all_but(*camera, 'pose_error'))
    forms = {row['name']: row['taken'] for row in table['calibration']['effects']}
    assert forms['fixed_pattern']
    json.dumps(table, allow_nan=False)
    found = {one['name']: one['parameters'] for one in table['effects']}
    effects = {one.name: one for one in load_effects(out / 'effects.yaml')}
    assert effects['fixed_pattern'].pattern.values.tolist() == found['fixed_pattern']['pattern']
    written = json.loads((out / 'diagnosis.json').read_text())
    (row,) = (one for one in written['effects'] if one['name'] == 'fixed_pattern')
    assert row['parameters']['pattern'] == 'fixed_pattern.npz'


def test_late_images_keep_their_delay_where_another_effect_gets_a_curve(tmp_path):
    grazing = {'curve': {'knots': [40.0, 60.0], 'values': [0.0, 0.5]}}
    camera = {'time_offset': {'latency': 0.08}, 'grazing_dropout': grazing}
    size = {'recordings': 4, 'frames': 8, 'scale': 0.35, 'moving': 3}
    recordings, out = tmp_path / 'recordings', tmp_path / 'out'
    write_campaign(recordings, seed=45, effects=camera, **size)
    for path in recordings.iterdir():
        change(path, received=lambda one: one['stamp'] + 0.05)
    table = diagnose(recordings, out=out, without=all_but(*camera, 'pose_error'))
    (row,) = table['calibration']['effects']
    assert row['taken']
    found = {one['name']: one['parameters'] for one in table['effects']}
    assert found['time_offset']['delay'] == pytest.approx(0.05)
    assert load_effects(out / 'effects.yaml') == parse_effects(found)


def test_noise_that_depends_on_the_incidence_gets_a_curve(tmp_path):
    """Assert it of surfaces that add noise of their own, which does not grow with the rest."""
    slant = {'knots': [20.0, 60.0], 'values': [1.8, 1.0]}
    write_campaign(tmp_path, seed=113, effects={'excess_noise': {'slant': slant}}, **SMALL)
    found = fitted_forms(tmp_path, {'excess_noise': {'factor': 1.5}})
    (one,) = found.explained.verdicts
    assert one.taken
    assert one.after.mean() < 0.7 * one.before.mean()
    (effect,) = found.effects(parse_effects({'excess_noise': {}}))
    np.testing.assert_allclose(effect.slant.at([15.0, 40.0, 65.0]), [1.8, 1.4, 1.0], rtol=0.1)
    shown = forms([one], found.explained.looked)
    assert 'excess noise: factor on sigma_z' in shown


def test_a_form_that_is_no_better_is_not_taken(tmp_path):
    right = {'offset': {'bias': 0.01}, 'low_signal_dropout': {'half': 0.1}}
    exact = {'pose': (0.0, 0.0), 'reflectivity': 0.0}
    write_campaign(tmp_path, seed=112, effects=right, **SMALL, **exact)
    found = fitted_forms(tmp_path, right)
    assert not found.taken
    assert len(found.explained.verdicts) == 2
    assert found.effects(parse_effects(right)) == list(parse_effects(right))


def test_too_few_recordings_give_no_form(campaign, tmp_path):
    for path in sorted(campaign.iterdir())[:2]:
        (tmp_path / path.name).symlink_to(path)
    assert fitted_forms(tmp_path, {'offset': {}}) is None


def test_a_map_needs_images_of_one_size(campaign, tmp_path):
    mixed = tmp_path / 'mixed'
    write_campaign(mixed, seed=113, effects={}, **{**SMALL, 'recordings': 1, 'scale': 0.25})
    for path in sorted(campaign.iterdir())[:2]:
        (mixed / f'large_{path.name}').symlink_to(path)
    found = fitted_forms(mixed, {'fixed_pattern': {}, 'wiggling': {}})
    assert [one.proposal.effect for one in found.explained.verdicts] == ['wiggling']


TINY = {'recordings': 4, 'frames': 6, 'scale': 0.25, 'moving': 0}
TINIEST = {'recordings': 3, 'frames': 2, 'scale': 0.15, 'moving': 0}


def test_a_filter_over_frames_gets_its_own_kernel(tmp_path):
    """Assert that a mean of four frames is not taken for a recursive filter."""
    filtered = {'temporal_filter': {'window': 4.0, 'gate': 100.0}}
    write_campaign(tmp_path, seed=117, effects=filtered, **{**TINY, 'frames': 12})
    found = fitted_forms(tmp_path, {'temporal_filter': {'share': 0.6}})
    (one,) = found.explained.verdicts
    assert one.taken
    assert one.proposal.label == 'mean of frames'
    assert one.proposal.together['window'] == pytest.approx(4.0, abs=0.5)


def test_light_that_bleeds_along_columns_is_told_from_light_that_stays(tmp_path):
    """Assert that the table is over light that bleeds in one camera alone."""
    for name, bleed in (('stays', {}), ('bleeds', {'bleed': 3.0})):
        full = {'half': 0.3, 'gloss': 0.0}
        effects = {'saturation': {**full, **bleed}}
        write_campaign(tmp_path / name, seed=118, effects=effects, **TINY)
        (one,) = fitted_forms(tmp_path / name, {'saturation': full}, quick=True).explained.verdicts
        assert one.proposal.together.get('bleed') == bleed.get('bleed')


def test_a_diagnosis_fits_all_forms_when_asked_for(tmp_path):
    """Assert it of a kernel that a search by simulation finds, from the command line."""
    filtered = {'spatial_filter': {'width': 1.0, 'mix': 1.0, 'gate': 8.0}}
    recordings, out = tmp_path / 'recordings', tmp_path / 'out'
    write_campaign(recordings, seed=114, effects=filtered, **TINY)
    kept = 'flying_pixels', 'lateral_noise', 'pose_error', *filtered
    table = run_diagnose(recordings, out, '--forms', 'all', *leaving(*kept))
    forms = {row['name']: row for row in table['calibration']['effects']}
    assert forms['spatial_filter']['taken']
    (found,) = (row for row in table['effects'] if row['name'] == 'spatial_filter')
    assert found['parameters']['width'] == pytest.approx(1.0, rel=0.3)
    with pytest.raises(InputError, match='forms: must be catalogue, quick, all, got .slow.'):
        diagnose(recordings, forms='slow')


LENS = {'focal': 0.01, 'cx': 0.5, 'cy': -0.4, 'k1': 0.03, 'aspect': 0.02, 'p2': 0.01}
# What a diagnosis may name: a part of the lens, and a pose error for the rest.
PART = {'focal': 0.006, 'cx': 0.2, 'cy': -0.2, 'k1': 0.02}
NAMED = {'pose_error': {'x': 0.002}, 'intrinsics_error': PART}


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    """Record rooms with a wrong lens, from poses that are wrong, too."""
    folder = tmp_path_factory.mktemp('lens') / 'recordings'
    size = {'recordings': 6, 'frames': 6, 'scale': 0.4, 'moving': 0}
    write_campaign(folder, seed=131, effects={'intrinsics_error': LENS}, **size)
    return folder


def test_a_wrong_lens_is_found_although_the_poses_are_wrong(recordings):
    """Assert that a pose error that was diagnosed beside a part of the lens is left out."""
    found = fitted_forms(recordings, NAMED)
    (one,) = found.explained.verdicts
    assert one.taken
    assert one.proposal.label == 'focal length, centre and distortion'
    assert one.after.mean() < one.before.mean()
    assert found.dropped == ['pose_error']
    (lens,) = found.effects(parse_effects(NAMED))
    assert lens.focal == pytest.approx(LENS['focal'], abs=0.004)
    assert lens.k1 == pytest.approx(LENS['k1'], abs=0.004)
    assert lens.aspect == pytest.approx(LENS['aspect'], abs=0.006)
    assert lens.p2 == pytest.approx(LENS['p2'], abs=0.003)


def test_a_lens_at_its_bounds_is_fitted_on(tmp_path):
    """Assert that a diagnosed lens at the end of what is allowed raises nothing."""
    write_campaign(tmp_path, seed=132, effects={'intrinsics_error': LENS}, **TINIEST)
    found = fitted_forms(tmp_path, {'intrinsics_error': {**LENS, 'cy': -20.0}})
    assert [one.proposal.effect for one in found.explained.verdicts] == ['intrinsics_error']


def test_a_recording_that_is_gone_is_an_error_that_names_it(recordings, tmp_path):
    names = sorted(one.name for one in recordings.glob('*.npz'))[:2]
    for name in names:
        shutil.copy(recordings / name, tmp_path)
    effects = {'intrinsics_error': PART}
    with workers(1, None) as mapped:
        simulator = Simulator(mapped, None, {}, 0, PRIOR)
        found, _ = find(tmp_path, None, mapped)
        jobs = [(one, effects, None) for one in found]
        looked = simulator.run(look, jobs, prior=simulator.prior)
        (tmp_path / names[1]).unlink()
        with pytest.raises(InputError, match=names[1]):
            simulator.run(look_again, [(one, effects) for one in looked])


def test_the_stamp_of_raw_frames_is_found_from_a_diagnosis_with_the_other_one(tmp_path):
    camera = {'motion_artefact': {'stretch': 2.5, 'stamp_at': 0.0}}
    size = {'recordings': 10, 'frames': 8, 'scale': 0.4, 'moving': 6}
    write_campaign(tmp_path, seed=141, effects=camera, **size)
    found = fitted_forms(tmp_path, {'motion_artefact': {'stretch': 0.6, 'stamp_at': 1.0}})
    (one,) = found.explained.verdicts
    assert one.taken
    assert one.proposal.label == 'duration of the raw frames, and the stamp'
    assert one.proposal.together['stamp_at'] == 0.0
    assert one.proposal.together['stretch'] == pytest.approx(2.5, abs=0.8)


def test_still_recordings_leave_raw_frames_as_diagnosed(tmp_path):
    write_campaign(tmp_path, seed=151, **TINIEST)
    found = fitted_forms(tmp_path, {'motion_artefact': {'stretch': 0.6}})
    assert not found.explained.verdicts

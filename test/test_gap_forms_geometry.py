"""The lens and the duration of raw frames are fitted together with the poses that hide them."""

import shutil

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.forms.looked import look, look_again, Simulator
from flexx2_sim_ros.gap.work import find
from flexx2_sim_ros.jobs import workers
from named_forms import fitted_forms
import pytest

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
    size = {'recordings': 3, 'frames': 2, 'scale': 0.15, 'moving': 0}
    write_campaign(tmp_path, seed=132, effects={'intrinsics_error': LENS}, **size)
    found = fitted_forms(tmp_path, {'intrinsics_error': {**LENS, 'cy': -20.0}})
    assert [one.proposal.effect for one in found.explained.verdicts] == ['intrinsics_error']


def test_a_recording_that_is_gone_is_an_error_that_names_it(recordings, tmp_path):
    names = sorted(one.name for one in recordings.glob('*.npz'))[:2]
    for name in names:
        shutil.copy(recordings / name, tmp_path)
    effects = {'intrinsics_error': PART}
    with workers(1, None) as mapped:
        simulator = Simulator(mapped, None, {}, 0, (0.01,) * 3 + (0.5,) * 3)
        found, _ = find(tmp_path, None, mapped)
        jobs = [(one, effects, None) for one in found]
        looked = simulator.run(look, jobs, prior=simulator.prior)
        (tmp_path / names[1]).unlink()
        with pytest.raises(InputError, match=names[1]):
            simulator.run(look_again, [(one, effects) for one in looked])


EFFECT = 'motion_artefact'


def test_the_stamp_of_raw_frames_is_found_from_a_diagnosis_with_the_other_one(tmp_path):
    camera = {EFFECT: {'stretch': 2.5, 'stamp_at': 0.0}}
    size = {'recordings': 10, 'frames': 8, 'scale': 0.4, 'moving': 6}
    write_campaign(tmp_path, seed=141, effects=camera, **size)
    found = fitted_forms(tmp_path, {EFFECT: {'stretch': 0.6, 'stamp_at': 1.0}})
    (one,) = found.explained.verdicts
    assert one.taken
    assert one.proposal.label == 'duration of the raw frames, and the stamp'
    assert one.proposal.together['stamp_at'] == 0.0
    assert one.proposal.together['stretch'] == pytest.approx(2.5, abs=0.8)


def test_still_recordings_leave_raw_frames_as_diagnosed(tmp_path):
    size = {'recordings': 3, 'frames': 2, 'scale': 0.15, 'moving': 0}
    write_campaign(tmp_path, seed=151, **size)
    found = fitted_forms(tmp_path, {EFFECT: {'stretch': 0.6}})
    assert not found.explained.verdicts

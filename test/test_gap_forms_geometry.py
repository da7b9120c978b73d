"""Parameters of the lens are fitted together with the poses that would hide them."""

import shutil

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.forms.bias_fit import BiasFit
from flexx2_sim_ros.gap.forms.geometry import shape_of
from flexx2_sim_ros.gap.forms.looked import look, look_again, Simulator
from flexx2_sim_ros.gap.forms.proposals import FormProposal, FormVerdict
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.gap.report.form_figures import figures
from flexx2_sim_ros.gap.work import find
from flexx2_sim_ros.jobs import workers
from named_forms import fitted_forms
import numpy as np
import pytest

LENS = {'focal': 0.01, 'cx': 0.5, 'cy': -0.4, 'k1': 0.03, 'aspect': 0.02, 'p2': 0.01}
# What a diagnosis may name: a part of the lens, and a pose error for the rest.
PART = {'focal': 0.006, 'cx': 0.2, 'cy': -0.2, 'k1': 0.02}
NAMED = {'pose_error': {'x': 0.002}, 'intrinsics_error': PART}
COUNT = 400


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


def make_samples(rng, moved, prior):
    """Return samples of a recording whose camera was moved by so many metres along its axis."""
    x, noise = np.linspace(-1, 1, COUNT), rng.standard_normal(COUNT) * 1e-4
    own = np.zeros((6, COUNT))
    own[0] = 1.0
    # A lens that changes depth nearly as the motion does.
    slopes = {'intrinsics_error': (1.0 + 0.05 * x)[None]}
    length = np.ones(COUNT)
    spread = np.diag([prior, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Samples(
        np.zeros(6), moved + 0.02 * slopes['intrinsics_error'][0] + noise,
        np.full(COUNT, 1e-3), own, spread, length, 2 + x, x, x, np.arange(COUNT), slopes,
    )  # fmt: skip


def test_the_prior_of_the_poses_becomes_as_wide_as_they_are():
    """Assert it of poses that are wrong by far less than was allowed for."""
    rng = np.random.default_rng(7)
    moved = 0.001 * np.array([1.0, -1.0, 0.8, -0.8, 1.2, -1.2])
    samples = [make_samples(rng, float(one), 0.05) for one in moved]
    columns, penalty = [one.slopes['intrinsics_error'] for one in samples], np.eye(1)
    fit = BiasFit(samples)
    narrow = fit.with_usual_poses(columns, penalty)
    assert 0.0005 < narrow.samples[0].spread[0, 0] < 0.01
    assert samples[0].spread[0, 0] == 0.05
    error = abs(narrow.solve(columns, penalty)[0] - 0.02)
    assert error < 0.002
    # Poses that are as wrong as was allowed for keep their prior.
    wide = BiasFit([make_samples(rng, float(one), 0.0002) for one in moved])
    assert wide.with_usual_poses(columns, penalty).samples[0].spread[0, 0] == 0.0002


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


def test_a_table_of_fitted_numbers_has_the_title_that_its_page_gives_it():
    lens = FormProposal('intrinsics_error', shape_of('intrinsics_error').label, LENS, (LENS,) * 3)
    shown = figures(
        [FormVerdict(lens, np.ones(3), np.zeros(3), True)], [], ('typical', 'as fitted')
    )
    assert '<th>intrinsics error</th><th>as fitted</th>' in shown
    assert '<td>cx</td><td>0.5</td><td>0</td>' in shown

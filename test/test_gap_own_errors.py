"""What the fitted poses of recordings have in common, and planes that were not measured."""

from types import SimpleNamespace

from bench.gap_campaigns import write_campaign
from bench.planes import NAMES, record, VIEWS
from campaigns import among
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap import diagnose, measure
from flexx2_sim_ros.gap.calibration.inference import LOSS
from flexx2_sim_ros.gap.data.pose import STEPS
from flexx2_sim_ros.gap.data.prior import prior_from_scatter
from flexx2_sim_ros.gap.inference.own_errors import common_motion, OwnErrors
from flexx2_sim_ros.gap.report.words import accuracy
from flexx2_sim_ros.truth import make_truth, PlaneRequest
import numpy as np
import pytest
import yaml

PRIOR = np.array([0.002] * 3 + [0.125] * 3)  # metres, degrees


def test_what_all_poses_share_is_in_common():
    rng = np.random.default_rng(1)
    shared = np.array([0.0, 0.0, -0.015, 1.5, 0.0, 0.0])
    found = common_motion(shared + PRIOR * rng.standard_normal((8, 6)))
    assert found[[2, 3]] == pytest.approx(shared[[2, 3]], rel=0.2)


@pytest.mark.parametrize('count', [2, 3, 8])
def test_poses_that_scatter_have_little_in_common(count):
    # In one of 20 sets, a motion is taken to be in common; then a part of its mean. Of 500 sets,
    # the fraction is off by 0.05 with a probability of 3e-7 (5 sigma).
    rng = np.random.default_rng(2)
    sets = PRIOR * rng.standard_normal((500, count, 6))
    found = np.array([common_motion(one) for one in sets])
    assert (found == 0).all(axis=1).mean() == pytest.approx(0.95, abs=0.05)
    assert (np.abs(found) <= np.abs(sets.mean(axis=1))).all()


def test_equal_poses_are_all_in_common():
    same = np.tile(PRIOR, (4, 1))
    assert common_motion(same) == pytest.approx(PRIOR)
    assert (common_motion(np.zeros((4, 6))) == 0).all()


def test_a_drift_of_the_depth_is_no_scatter_of_poses():
    # Of two scatters of eight, the larger is more than 2.5 times the true one, or less than a
    # fourth of it, with a probability of 6e-7 (chi-square, 7 degrees of freedom).
    poses = PRIOR * np.random.default_rng(3).standard_normal((8, 6))
    drift = np.zeros((8, 6))
    drift[:, 2] = np.linspace(0, 0.05, 8)
    found = prior_from_scatter(poses + drift) / PRIOR
    assert ((found > 0.25) & (found < 2.5)).all()
    assert (prior_from_scatter(np.zeros((3, 6))) > 0).all()


@pytest.mark.parametrize('stated', [True, False])
def test_what_poses_cost_is_their_part_of_the_loss(stated):
    one = SimpleNamespace(pose=np.zeros(6), planes=np.zeros(0))
    own = OwnErrors([one] * 4, [np.diag(PRIOR**2) if stated else None] * 4, LOSS)
    shared = np.zeros((4, 6))
    shared[:, 2] = 0.01
    costs = own.cost(shared)
    assert own.cost(np.zeros((4, 6))) == pytest.approx(np.zeros(4))
    assert (own.cost(2 * shared) > costs).all()
    moved = np.zeros((4, own.count))
    moved[:, :6] = shared / STEPS
    assert costs.sum() == pytest.approx(own.loss(moved, False))
    assert own.loss(moved, True) == pytest.approx(0)  # as an error that they have in common


@pytest.mark.parametrize('effect', registry())
def test_no_effect_of_the_catalogue_makes_a_gap_on_free_planes(effect, tmp_path):
    """
    Assert it within 1 mm, of a corner of which nothing was measured and 56 x 43 pixels.

    An effect must not take planes along, to be named for the way back.
    """
    recordings = record(tmp_path / 'in', views=VIEWS[:1], others=(effect,), step=2)
    planes, out = tmp_path / 'planes.yaml', tmp_path / 'out'
    rows = [{'name': name} for name in NAMES]  # The largest of the image.
    planes.write_text(yaml.safe_dump({'schema': 1, 'planes': rows}))
    table = make_truth(PlaneRequest(recordings=(recordings,), planes=planes, out=out))
    with np.load(out / 'corner0.npz') as file:
        depth, known = np.where(file['depth'] > 0, file['depth'], np.nan), file['known']
        off = np.abs(np.nanmean(depth[:, known], axis=0) - file['clean_depth'][known])
    kept = {effect, 'offset', 'warm_up_drift', 'amplitude_bias', 'multipath', 'intrinsics_error'}
    found = diagnose(out, **among(*kept))
    hidden = {row['effect'] for row in table['cannot_decide']}
    assert {row['name'] for row in found['effects']} <= {effect} - hidden
    gap = found['gap']['wasserstein_mm']
    assert max(gap['before'], gap['after']) < 1000 * np.nanmean(off) + 1


@pytest.mark.parametrize(('sigma', 'said'), [(0.0, ''), (0.003, 'depth known to 3 mm, ')])
def test_depth_is_not_said_to_be_known_to_0_mm(sigma, said):
    planes = {'planes': 3, 'offset': 0.1, 'tilt': 5.0}
    nothing = dict.fromkeys(('unknown', 'pose', 'turn'))
    assert accuracy([{**nothing, **planes, 'sigma': sigma}]) == f'{said}planes to 100 mm and 5 deg'


def test_poses_stay_as_near_as_is_stated(tmp_path):
    """Assert it of a bias that grows with the distance, which poses could take over."""
    camera = {'intrinsics_error': {'focal': 0.01}}
    write_campaign(tmp_path, seed=12, effects=camera, recordings=6, frames=6, scale=0.25, moving=0)
    few = among('intrinsics_error', 'offset', 'pose_error')
    priors = None, (0.002, 0.125)
    tables = [diagnose(tmp_path, pose_prior=prior, **few) for prior in priors]
    free, held = (
        np.sqrt(np.mean([np.square(row['pose'][:3]) for row in table['recordings']]))
        for table in tables
    )
    assert held < min(free, 0.006)
    assert tables[1]['settings']['pose_prior'] == [0.002, 0.125]
    assert [table['settings']['pose_held'] for table in tables] == [False, True]
    # So they do where a set of effects is only measured: the poses hide less of the gap.
    free, held = (measure(tmp_path, camera, pose_prior=prior)['before'] for prior in priors)
    assert held > free


def test_beside_several_effects_poses_are_held_by_their_scatter(tmp_path):
    effects = {'offset': {'bias': 0.03}, 'random_dropout': {'share': 0.05}}
    small = {'recordings': 6, 'frames': 6, 'scale': 0.25, 'moving': 0}
    write_campaign(tmp_path, seed=12, effects=effects, **small)
    table = diagnose(tmp_path, **among('pose_error', *effects))
    assert {row['name'] for row in table['effects']} == set(effects)
    settings = table['settings']
    assert (settings['pose_held'], settings['pose_stated']) == (True, False)
    assert settings['pose_prior'][0] < 0.006
    reasons = {row['name']: row['reason'] for row in table['not_considered']}
    assert 'how much they scatter' in reasons['pose_error']

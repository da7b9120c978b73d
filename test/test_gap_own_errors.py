"""What the fitted poses of recordings have in common."""

from flexx2_sim_ros.gap.inference.own_errors import common_motion
import numpy as np
import pytest

PRIOR = np.array([0.002] * 3 + [0.125] * 3)  # metres, degrees


def test_what_all_poses_share_is_in_common() -> None:
    rng = np.random.default_rng(1)
    shared = np.array([0.0, 0.0, -0.015, 1.5, 0.0, 0.0])
    found = common_motion(shared + PRIOR * rng.standard_normal((8, 6)))
    assert found[[2, 3]] == pytest.approx(shared[[2, 3]], rel=0.2)


@pytest.mark.parametrize('count', [2, 3, 8])
def test_poses_that_scatter_have_little_in_common(count: int) -> None:
    # In one of 20 sets, a motion is taken to be in common; then a part of its mean. Of 500 sets,
    # the fraction is off by 0.05 with a probability of 3e-7 (5 sigma).
    rng = np.random.default_rng(2)
    sets = PRIOR * rng.standard_normal((500, count, 6))
    found = np.array([common_motion(one) for one in sets])
    assert (found == 0).all(axis=1).mean() == pytest.approx(0.95, abs=0.05)
    assert (np.abs(found) <= np.abs(sets.mean(axis=1))).all()


def test_equal_poses_are_all_in_common() -> None:
    same = np.tile(PRIOR, (4, 1))
    assert common_motion(same) == pytest.approx(PRIOR)
    assert (common_motion(np.zeros((4, 6))) == 0).all()

"""Effects that are as wrong as their fit leaves open: what a prediction is made with."""

from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.gap.inference.jackknife import as_wrong_as_fitted
import numpy as np
import pytest

SEED = 5


def offset(bias):
    """Return the settings of an offset."""
    return {'offset': {'strength': 1.0, 'bias': bias}}


def test_values_deviate_by_the_standard_error():
    """Assert it for a mean of numbers, whose standard error is known."""
    count = 9
    sizes = np.random.default_rng(SEED).normal(0.01, 0.002, count)
    together = offset(float(sizes.mean()))
    without = [offset(float(np.delete(sizes, i).mean())) for i in range(count)]
    wrong = as_wrong_as_fitted(together, without)
    errors = np.array([one['offset']['bias'] for one in wrong]) - sizes.mean()
    assert np.square(errors).mean() == pytest.approx(sizes.var(ddof=1) / count)
    assert all(one['offset']['strength'] == 1.0 for one in wrong)


def test_what_one_recording_alone_says_is_no_error():
    without = [offset(0.01 + error) for error in (1e-4, -1e-4, 1e-4, -1e-4, 0.0, -0.01)]
    wrong = as_wrong_as_fitted(offset(0.01), without)
    errors = np.array([one['offset']['bias'] for one in wrong]) - 0.01
    assert 0 < np.sqrt(np.square(errors).mean()) < 0.006


def test_curves_deviate_and_stay_within_the_bounds_of_the_effect():
    def bias(*values):
        return {'amplitude_bias': {'strength': 1.0, 'curve': Curve((0.0, 1.0), values)}}

    without = [bias(0.01, 0.4), bias(0.02, 0.5), bias(0.0, 0.5)]
    wrong = [
        one['amplitude_bias']['curve'] for one in as_wrong_as_fitted(bias(0.01, 0.49), without)
    ]
    assert all(one.knots == (0.0, 1.0) for one in wrong)
    assert any(one.values[0] != 0.01 for one in wrong)
    assert all(abs(one.values[0] - 0.01) < 0.02 and one.values[1] <= 0.5 for one in wrong)


def test_what_poses_cannot_take_over_is_as_fitted_without_the_recording():
    together = {'temporal_filter': {'strength': 1.0, 'share': 0.5}}
    without = [{'temporal_filter': {'strength': 1.0, 'share': one}} for one in (0.4, 0.5, 0.7)]
    assert as_wrong_as_fitted(together, without) == without


def test_another_curve_or_one_recording_changes_nothing():
    def curve(*knots):
        return {'offset': {'strength': 1.0, 'bias': 0.0, 'curve': Curve(knots, (0.1, 0.2))}}

    assert as_wrong_as_fitted(offset(0.02), [offset(0.02)]) == [offset(0.02)]
    without = [curve(0.0, 1.0), curve(0.0, 2.0)]
    assert as_wrong_as_fitted(curve(0.0, 1.0), without) == without

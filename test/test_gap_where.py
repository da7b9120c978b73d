"""Where a gap lies: the covariate that it depends on, and conditions on pixels."""

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.data.axes import AXES, ENDLESS
from flexx2_sim_ros.gap.features.pixel_groups import GROUP_CHANNELS, GROUP_TOLERANCE, PixelGroups
from flexx2_sim_ros.gap.inference.cover import cover, shows_along
import numpy as np
import pytest


def made_up_groups(differs, size=0.5):
    """Return a group for each bin of distance and region, and an offset where it differs."""
    far, region = (a.ravel() for a in np.indices((AXES['distance'].bins, 12)))
    samples = np.zeros((len(far), 12, len(ENDLESS)), np.int16)
    for i, name in enumerate(ENDLESS):
        place = {'distance': far, 'region': region}.get(name)
        samples[:, :, i] = (
            -1
            if name in ('edge', 'speed')
            else AXES[name].start + (0 if place is None else place[:, None])
        )
    effect = np.zeros((len(far), len(GROUP_CHANNELS)))
    effect[:, 0] = size * differs.ravel()
    limit = np.broadcast_to(GROUP_TOLERANCE, effect.shape)
    return PixelGroups(
        np.full(len(far), 2000.0), effect, 0 * effect, 0.002 * effect[:, 0], limit, limit, samples
    )


def test_conditions_single_out_the_pixels_that_differ():
    differs = np.zeros((AXES['distance'].bins, 12), bool)
    assert cover([made_up_groups(differs)], False) == []
    differs[3:6] = True
    (one,) = cover([made_up_groups(differs)] * 2, False)
    assert (one.axis, one.first, one.last) == ('distance', 3, 5)
    assert one.difference[0] == pytest.approx(0.5)
    assert cover([made_up_groups(differs)], True) == []  # the real camera shows none of it
    differs[:, 7] = True
    both = cover([made_up_groups(differs)] * 2, False)
    assert {(c.axis, c.first, c.last) for c in both} == {('distance', 3, 5), ('region', 7, 7)}
    # In one of two recordings only; everywhere.
    (one,) = cover([made_up_groups(0 * differs), made_up_groups(0 * differs + 1)], False)
    assert (one.axis, one.first, one.last) == ('recording', 1, 1)
    (one,) = cover([made_up_groups(0 * differs + 1)], False)
    assert one.axis == 'all'
    # Each recording has its own size.
    both = cover(
        [
            made_up_groups(0 * differs),
            made_up_groups(0 * differs + 1),
            made_up_groups(0 * differs + 1, 0.8),
        ],
        False,
    )
    assert [(c.axis, c.first, c.last) for c in both] == [('recording', 1, 1), ('recording', 2, 2)]
    assert [c.bias for c in both] == pytest.approx([0.001, 0.0016])


def test_a_named_effect_says_which_of_two_like_covariates_is_meant():
    """Assert it where distant pixels are those of some regions, and only if the data allow it."""
    differs = np.zeros((AXES['distance'].bins, 12), bool)
    differs[3:6, :8] = True
    known = registry()
    for named, axis in (
        ((), 'distance'),
        (('wiggling',), 'distance'),
        (('intrinsics_error',), 'region'),
        (('flying_pixels',), 'distance'),  # no pixel is at an edge
    ):
        expected = {one for name in named for one in shows_along(known[name])}
        first, *_ = cover([made_up_groups(differs)], False, expected=expected)
        assert first.axis == axis, named


def test_a_drift_is_said_of_uptimes():
    differs = np.ones((AXES['distance'].bins, 12), bool)
    groups = [made_up_groups(differs, size) for size in (3.0, 2.0, 0.0, 0.0)]
    uptimes = [10.0, 60.0, 300.0, 900.0]
    drift = shows_along(registry()['warm_up_drift'])
    (one,) = cover(groups, False, expected=drift, uptimes=uptimes)
    assert (one.axis, one.first, one.last) == ('uptime', 0, 1)
    # Recordings that do not say when are listed one by one.
    both = cover(groups, False, expected=drift, uptimes=[None] * 4)
    assert [(one.axis, one.first) for one in both] == [('recording', 0), ('recording', 1)]

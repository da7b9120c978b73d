"""Where a gap lies: the covariate that it depends on, and conditions on pixels."""

from types import SimpleNamespace

from bench.gap_campaigns import look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.data.axes import AXES, axes_of, ENDLESS
from flexx2_sim_ros.gap.data.registration import Placed, RecordingData
from flexx2_sim_ros.gap.features.features import Feature, LAYOUT, SIZE, TOLERANCE
from flexx2_sim_ros.gap.features.pixel_groups import (
    GROUP_CHANNELS,
    GROUP_TOLERANCE,
    GroupSums,
    PixelGroups,
)
from flexx2_sim_ros.gap.features.simulation import Scenes
from flexx2_sim_ros.gap.inference.cover import cover, shows_along
from flexx2_sim_ros.gap.inference.where import beside
import numpy as np
import pytest


def made_up(count, noise):
    """Return what `beside` asks of a model, with nothing in it."""
    shape = (count, SIZE)
    counts = np.concatenate([np.full(axis.bins, 1e4 / axis.bins) for axis in AXES.values()])
    evidence = [
        SimpleNamespace(
            counts=counts,
            sigma=np.full(len(counts), 0.002),
            name=f'{r}.npz',
            uptime=None,
            axes=axes_of(flexx2()),
        )
        for r in range(count)
    ]
    return SimpleNamespace(
        good=np.ones(shape, bool),
        gap=np.zeros(shape),
        evidence=evidence,
        scale2=np.broadcast_to(TOLERANCE**2 + noise**2, shape),
    )


def test_what_differs_in_whole_images_and_beyond_surfaces_is_listed_beside():
    model = made_up(6, 0.001)
    difference = np.zeros((6, SIZE))
    for one in (Feature('static_grain', 'structure', 0), Feature('invalid', 'beyond', 0)):
        difference[:, LAYOUT.index(one)] = 0.5
    # A recording without such pixels counts for nothing.
    model.good[0], difference[0] = False, 9.0
    rows = [row for _, row in beside(model, difference, False, 2 * difference)]
    assert [(row['covariate'], row['channel']) for row in rows] == [
        ('nothing there', 'invalid'),
        ('structure', 'static_grain'),
    ]
    assert [row['size'] for row in rows] == pytest.approx([1.0, 1.0])
    noisy, some = made_up(5, 1.0), difference[1:]
    assert beside(noisy, some, False, some) == []  # lost in noise
    assert beside(model, bias_along(6, 'all', {0: 1.0}), True, difference) == []  # of surfaces


def bias_along(count, axis, places):
    """Return features of a bias in some bins of an axis, spread thin along all others."""
    difference = np.zeros((count, SIZE))
    for i, feature in enumerate(LAYOUT):
        if feature.channel == 'bias' and feature.axis not in ('edge', 'structure'):
            difference[:, i] = sum(places.values()) / AXES[axis].bins
            if feature.axis == axis:
                difference[:, i] = places.get(feature.place, 0.0)
    return difference


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


def test_groups_show_what_an_effect_changes_and_where():
    K = flexx2().intrinsics.matrix  # noqa: N806
    room = make_room(np.random.default_rng(2))
    clean, rho = look(room, K, (172, 224), optical(0.1, 0.35, 0.0), np.array([0.0, 0.1, 0.6]))
    stamps = np.arange(12) * 33_000_000
    steep = {'grazing_dropout': {'half_deg': 60.0}}
    plain, real = (
        Camera(effects=effects, seed=1).capture(clean, K, stamps, rho).depth
        for effects in ({}, steep)
    )
    recording = RecordingData(
        '',
        real,
        clean,
        rho,
        K,
        stamps,
        np.arange(12) == 0,
        None,
        flexx2().mode('Mode_9_30fps'),
        None,
    )
    placed = Placed(clean, rho, None, 0)
    sums = GroupSums(recording, clean, rho, Scenes(recording, placed))
    before, after = sums.add(plain), sums.add(real)
    groups = sums.groups(after, [before], [after], 12)
    # Of the sums themselves: each pixel once a frame.
    assert before[:, 0].sum() == 12 * np.isfinite(clean).sum()
    assert before[:, 1].sum() == np.isfinite(plain).sum()
    lost = GROUP_CHANNELS.index('invalid')
    assert np.average(groups.effect[:, lost], weights=groups.count) == pytest.approx(
        np.mean(~np.isfinite(real)) - np.mean(~np.isfinite(plain)), abs=0.02
    )
    assert np.array_equal(groups.effect, groups.real)
    found = cover([groups], False)
    assert found[0].axis == 'incidence'
    assert found[0].difference[lost] > 0.1
    assert cover([sums.groups(before, [before], [before], 12)], True) == []

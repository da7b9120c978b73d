"""Where a gap lies: the covariate that it depends on, and conditions on pixels."""

from types import SimpleNamespace
from typing import Any

from bench.gap_campaigns import look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap.calibration.inference import WHERE
from flexx2_sim_ros.gap.data.axes import AXES, axes_of, ENDLESS
from flexx2_sim_ros.gap.data.covariates import look_at
from flexx2_sim_ros.gap.data.registration import Placed, RecordingData
from flexx2_sim_ros.gap.features.changes import count_changes
from flexx2_sim_ros.gap.features.features import Feature, LAYOUT, SIZE, TOLERANCE
from flexx2_sim_ros.gap.features.pixel_groups import (
    GROUP_CHANNELS,
    GROUP_TOLERANCE,
    GroupSums,
    PixelGroups,
)
from flexx2_sim_ros.gap.features.simulation import Scenes
from flexx2_sim_ros.gap.inference.cover import cover
from flexx2_sim_ros.gap.inference.main_covariate import main_covariate
from flexx2_sim_ros.gap.inference.told import told, uncertainty_coefficient
from flexx2_sim_ros.gap.inference.where import beside
from flexx2_sim_ros.gap.report.places import finding
import numpy as np
import pytest


def made_up(count: int, noise: float) -> Any:
    """Return what `beside` and `main_covariate` ask of a model, with nothing in it."""
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


def test_what_differs_in_whole_images_and_beyond_surfaces_is_listed_beside() -> None:
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


def bias_along(count: int, axis: str, places: dict[int, float]) -> np.ndarray:
    """Return features of a bias in some bins of an axis, spread thin along all others."""
    difference = np.zeros((count, SIZE))
    for i, feature in enumerate(LAYOUT):
        if feature.channel == 'bias' and feature.axis not in ('edge', 'structure'):
            difference[:, i] = sum(places.values()) / AXES[axis].bins
            if feature.axis == axis:
                difference[:, i] = places.get(feature.place, 0.0)
    return difference


def test_the_first_row_is_the_covariate_that_the_gap_depends_on() -> None:
    model = made_up(6, 0.001)
    # Bins beside the largest difference belong to it, if they have its sign and half its size.
    places = {3: 0.2, 4: 0.6, 5: 1.0, 8: -0.9}
    difference = bias_along(6, 'log_amplitude', places)
    model.gap = difference
    one = main_covariate(model, difference, difference, False)
    assert one is not None
    assert (one.axis, one.first, one.last, one.channel) == ('log_amplitude', 4, 5, 'bias')
    assert one.difference == pytest.approx(0.8)
    assert one.size == pytest.approx(1.6)  # mm, at a sigma of 2 mm
    assert main_covariate(model, 0 * difference, difference, False) is None
    assert main_covariate(made_up(6, 1.0), 0.3 * difference, difference, False) is None  # noise
    # The same everywhere.
    difference = bias_along(6, 'all', {0: 0.5})
    one = main_covariate(model, difference, difference, True)
    assert one is not None
    assert one.axis == 'all'


def test_a_named_effect_says_which_of_two_like_covariates_is_meant() -> None:
    """Assert it where dark surfaces are the distant ones, and only if the data allow it."""
    model = made_up(6, 0.001)
    near, dark = ({3: 1.0}, {3: 0.9})
    difference = bias_along(6, 'distance', near)
    for i, feature in enumerate(LAYOUT):
        if (feature.channel, feature.axis) == ('bias', 'log_amplitude'):
            difference[:, i] = dark.get(feature.place, 0.0)
    known = registry()
    for named, axis in (
        ((), 'distance'),
        ((known['amplitude_bias'],), 'log_amplitude'),
        ((known['wiggling'],), 'distance'),
        ((known['grazing_dropout'],), 'distance'),  # nothing differs along incidence alone
    ):
        one = main_covariate(model, difference, difference, True, named)
        assert one is not None
        assert one.axis == axis, named


def test_few_pixels_with_large_changes_do_not_hide_what_a_lens_does() -> None:
    """Assert that the covariate which tells most about a pixel is first, and only if named."""
    model = made_up(6, 0.001)
    difference = bias_along(6, 'region', {2: 1.0, 9: -1.0})
    for i, feature in enumerate(LAYOUT):
        if (feature.channel, feature.axis) == ('bias', 'edge'):
            difference[:, i] = 20.0
    lens = (registry()['intrinsics_error'],)
    for named, tells, axis in (
        (lens, {'region': 0.2, 'edge': 0.03, 'incidence': 0.4}, 'region'),
        ((), {}, 'edge'),
        (lens, {'region': 0.02, 'edge': 0.3}, 'edge'),  # a change that is at edges after all
        (lens, {}, 'edge'),
    ):
        one = main_covariate(model, difference, difference, True, named, tells)
        assert one is not None
        assert one.axis == axis, tells


def test_what_acts_on_all_pixels_alike_is_said_of_whole_images() -> None:
    model = made_up(6, 0.001)
    difference = bias_along(6, 'fine_distance', {20: 1.0})
    grain = LAYOUT.index(Feature('static_grain', 'structure', 0))
    difference[:, grain] = 0.1
    model.gap = difference
    pattern = (registry()['fixed_pattern'],)
    nothing = {'fine_distance': 0.004, 'region': 0.001}
    one = main_covariate(model, difference, difference, True, pattern, nothing)
    assert one is not None
    assert (one.axis, one.channel, one.size) == ('structure', 'static_grain', pytest.approx(0.1))
    row = {
        'covariate': 'structure',
        'channel': 'static_grain',
        'size': 0.1,
        'unit_size': 'sigma^2',
        **dict.fromkeys(('low', 'high')),
        **dict.fromkeys(('unit', 'detail'), ''),
    }
    said = 'The gap is alike everywhere: fixed-pattern noise +0.1 sigma_z^2. '
    assert finding(row).startswith(said)


def test_a_difference_that_whole_images_do_not_show_is_said_of_its_covariate() -> None:
    model = made_up(6, 0.001)
    difference = bias_along(6, 'region', {2: 1.0, 9: -1.0})  # 0 in the mean of an image
    offset = (registry()['offset'],)
    one = main_covariate(model, difference, difference, True, offset, {'region': 0.02})
    assert one is not None
    assert (one.axis, one.difference) == ('region', pytest.approx(1.0))


def test_a_difference_that_is_everywhere_but_not_the_same_is_said_of_its_covariate() -> None:
    """Assert it for a lens, and that whole images are named where it is the same."""
    model = made_up(6, 0.001)
    bins = AXES['radius'].bins
    lens = (registry()['intrinsics_error'],)
    for sizes, axis, first in (
        (np.where(np.arange(bins) < bins // 2, 0.55, 1.0), 'radius', bins // 2),  # all above half
        (np.full(bins, 1.0), 'all', 0),
    ):
        difference = bias_along(6, 'radius', dict(enumerate(sizes)))
        for tells in ({}, {'radius': 0.02}):  # a rare change tells little about a pixel
            one = main_covariate(model, difference, difference, True, lens, tells)
            assert one is not None
            assert (one.axis, one.first) == (axis, first), (tells, one)


def test_a_drift_is_said_of_uptimes_even_if_it_does_not_only_fall() -> None:
    model = made_up(6, 0.001)
    size = np.array([6.0, 4.0, 4.5, 3.5, 3.0, 3.0])
    difference = size[:, None] * bias_along(6, 'all', {0: 1.0})
    uptimes = [10.0, 60.0, 300.0, 900.0, 2400.0, 2400.0]
    for one, uptime in zip(model.evidence, uptimes, strict=True):
        one.uptime = uptime
    drift = (registry()['warm_up_drift'],)
    found = main_covariate(model, difference, difference, True, drift, {'recording': 0.02})
    assert found is not None
    assert (found.axis, found.first, found.last) == ('uptime', 0, 0)


def test_a_recording_is_named_only_if_nothing_else_singles_it_out() -> None:
    model = made_up(6, 0.001)
    size = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    difference = size[:, None] * bias_along(6, 'all', {0: 1.0})
    for uptimes, expected in (
        ([None] * 6, ('recording', 2)),
        ([10.0, 60.0, 300.0, 900.0, 2400.0, 2400.0], ('recording', 2)),  # neither rises nor falls
    ):
        for one, uptime in zip(model.evidence, uptimes, strict=True):
            one.uptime = uptime
        found = main_covariate(model, difference, difference, True)
        assert found is not None
        assert (found.axis, found.first) == expected
    # A drift: the first two intervals differ most.
    size = np.array([6.0, 5.0, 2.0, 1.0, 0.0, 0.0])
    difference = size[:, None] * bias_along(6, 'all', {0: 1.0})
    found = main_covariate(model, difference, difference, True)
    assert found is not None
    assert (found.axis, found.first, found.last) == ('uptime', 0, 1)


def made_up_groups(differs: np.ndarray, size: float = 0.5) -> PixelGroups:
    """Return a group for each bin of distance and region, and an offset where it differs."""
    far, region = (a.ravel() for a in np.indices((AXES['distance'].bins, 12)))
    samples = np.zeros((len(far), 12, len(ENDLESS)), np.int16)
    for i, name in enumerate(ENDLESS):
        place = {'distance': far, 'region': region}.get(name)
        samples[:, :, i] = (
            -1 if name == 'edge' else AXES[name].start + (0 if place is None else place[:, None])
        )
    effect = np.zeros((len(far), len(GROUP_CHANNELS)))
    effect[:, 0] = size * differs.ravel()
    limit = np.broadcast_to(GROUP_TOLERANCE, effect.shape)
    return PixelGroups(
        np.full(len(far), 2000.0), effect, 0 * effect, 0.002 * effect[:, 0], limit, limit, samples
    )


def test_conditions_single_out_the_pixels_that_differ() -> None:
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


def test_groups_show_what_an_effect_changes_and_where() -> None:
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


@pytest.mark.parametrize(
    ('effect', 'axis'),
    [
        ({'offset': {'bias': 0.01}}, ''),
        ({'fixed_pattern': {}}, ''),
        ({'quantisation': {}}, ''),
        ({'excess_noise': {}}, ''),
        ({'random_dropout': {}}, ''),
        ({'grazing_dropout': {'half_deg': 60.0}}, 'incidence'),
        ({'lateral_noise': {}}, 'edge'),
    ],
)
def test_a_covariate_tells_what_an_effect_changes_or_none_does(
    effect: dict[str, Any], axis: str
) -> None:
    K = flexx2().intrinsics.matrix  # noqa: N806
    room = make_room(np.random.default_rng(2))
    clean, rho = look(room, K, (172, 224), optical(0.1, 0.35, 0.0), np.array([0.0, 0.1, 0.6]))
    stamps = np.arange(4) * 33_000_000
    plain, real = (
        Camera(effects=effects, seed=1).capture(clean, K, stamps, rho).depth
        for effects in ({}, effect)
    )
    mode, axes = flexx2().mode('Mode_9_30fps'), axes_of(flexx2())
    scene = look_at(clean, None, 0.0, rho, K, mode, axes)
    counts = count_changes(plain, real, [scene])
    tells = told([counts])
    if axis:
        assert max(tells, key=lambda name: tells[name]) == axis
        assert tells[axis] > WHERE.tells
    else:
        assert max(tells.values()) < WHERE.tells / 2
    assert told([count_changes(plain, plain, [scene])]) == {}


def test_an_uncertainty_coefficient_is_a_fraction_of_the_entropy() -> None:
    assert uncertainty_coefficient(np.full((3, 4), 100.0)) == pytest.approx(0)
    assert uncertainty_coefficient(np.zeros((3, 4))) == 0
    entropy = np.log(3)
    assert uncertainty_coefficient(np.diag(np.full(3, 100.0))) == pytest.approx(
        entropy / (entropy + WHERE.least_entropy)
    )

"""What effects keep between frames, and for which environments."""

import math

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import parse_effects, registry
from flexx2_sim_ros.errors import InputError
import numpy as np
import pytest
from signatures import QUIET
from small_scenes import capture, same, scenes, SHADES, SMALL

PERIOD = 33_333_333
KEEPS = {name: {'strength': 2.0} for name, kind in registry().items() if kind.keeps}


def test_a_reset_forgets_the_chosen_environments_only():
    keepers = {'fixed_pattern', 'temporal_filter', 'warm_up_drift', 'motion_artefact'}
    assert set(KEEPS) >= keepers | {'time_offset', 'multipath'}
    clean = np.stack([scenes(4), scenes(4) + 0.3])
    stamps = np.array([0, 1, 2, 3]) * 20 * PERIOD

    def run(mask):
        camera = Camera(effects=KEEPS, seed=2)
        camera.capture(clean[:, :3], SMALL, stamps[:3])
        if mask is not False:
            camera.reset(mask)
        return camera.capture(clean[:, 3:], SMALL, stamps[3:]).depth

    on, anew = run(False), run(None)
    fresh = Camera(effects=KEEPS, seed=2).capture(clean[:, 3:], SMALL, stamps[3:]).depth
    np.testing.assert_array_equal(anew, fresh)
    assert np.isclose(on, anew, atol=1e-4).mean() < 0.2
    second = run([False, True])
    np.testing.assert_array_equal(second[0], on[0])
    np.testing.assert_array_equal(second[1], anew[1])
    np.testing.assert_array_equal(run([False, False]), on)


def test_a_mask_that_does_not_fit_is_refused():
    camera = Camera(effects=KEEPS)
    camera.reset([True])  # There is nothing to forget yet.
    camera.capture(np.stack([scenes(1), scenes(1)]), SMALL, 0)
    for bad in ([True], [True] * 3, [[True, False]], True, [0, 1], 'all'):
        with pytest.raises(InputError, match='^mask: .*environments'):
            camera.reset(bad)
    camera.reset(np.array([True, False])[:, None])


def test_effects_restart_after_an_earlier_stamp_or_another_batch_size():
    stamps = np.arange(3) * 20 * PERIOD
    first = capture(KEEPS, scenes(3), stamps)
    camera = Camera(effects=KEEPS, seed=3)
    for _ in range(2):
        assert same(camera.capture(scenes(3), SMALL, stamps, SHADES), first)
    for count in (1, 2):
        many = camera.capture(np.stack([scenes(3)] * count), SMALL, stamps, SHADES)
        np.testing.assert_array_equal(many.depth[-1], first.depth)
    # The same stamp again is the same moment.
    camera.capture(scenes(3)[2], SMALL, stamps[2], SHADES)
    again = camera.capture(scenes(3)[2], SMALL, stamps[2], SHADES)
    assert np.isfinite(again.depth).any()


def test_effects_can_be_changed_between_two_frames():
    camera = Camera(effects={'warm_up_drift': None, 'temporal_filter': None}, profile=QUIET)
    wall = np.ones((4, 4))
    assert camera.capture(wall, SMALL, 0).depth[0, 0] == pytest.approx(1.01)
    camera.effects = {'warm_up_drift': {'bias': 0.02}, 'offset': {'bias': 0.1}}
    # Still on since then; the filter that is off has forgotten.
    later = camera.capture(wall, SMALL, 900.0).depth[0, 0]
    assert later == pytest.approx(1.1 + 0.02 / math.e, abs=1e-5)
    camera.effects = ()
    assert camera.capture(wall, SMALL, 901.0).depth[0, 0] == 1.0
    with pytest.raises(InputError, match='^effects: must have offset once, got it 2 times'):
        camera.effects = parse_effects({'offset': None}) * 2
    assert camera.effects == ()


def test_the_kernel_of_a_filter_can_be_changed_between_two_frames():
    """Assert that none of the kernels stumbles over what another one has kept."""
    camera, wall = Camera(profile=QUIET), np.ones((4, 4))
    kernels = ({}, {'second': 0.5}, {'window': 3.0}, {'second': 0.5}, {'window': 1.0}, {})
    for step, kernel in enumerate(kernels):
        camera.effects = {'temporal_filter': kernel}
        for k in range(3):
            seen = camera.capture(wall, SMALL, step + k / 30)
            np.testing.assert_allclose(seen.depth, 1.0, atol=1e-5)


@pytest.mark.parametrize('before', [{}, {'offset': {'bias': 0.0}}])
@pytest.mark.parametrize('seen', [True, False])
def test_the_time_since_power_on_counts_every_frame(before, seen):
    """Assert that a camera that streams without the drift, or unseen, is warm afterwards."""
    camera, wall = Camera(effects=before, profile=QUIET), np.ones((4, 4))
    for second in (0, 1800, 3600):
        if seen:
            camera.capture(wall, SMALL, second * 10**9)
        else:
            camera.skip(second * 10**9)
    camera.effects = {**before, 'warm_up_drift': {'bias': 0.1, 'tau': 900.0}}
    depth = camera.capture(wall, SMALL, 4500 * 10**9).depth[0, 0]
    assert depth == pytest.approx(1 + 0.1 * math.exp(-5), abs=1e-5)

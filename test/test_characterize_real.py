"""Real frames of a Kinect v2 and an Azure Kinect give the figures that are known of them."""

import math

from flexx2_sim_ros.characterize.amplitude import count_invalid, sigma_against
from flexx2_sim_ros.characterize.board_finding import find_board
from flexx2_sim_ros.characterize.measurement import measure
from flexx2_sim_ros.characterize.moments import Accumulator
from flexx2_sim_ros.characterize.pixel_statistics import FrameMeans, pixel_statistics
from flexx2_sim_ros.characterize.tiles import join
import numpy as np
import pytest
from real_frames import kinect_views, load

# Within 15 % of what is known of the data.
AGREEMENT = 0.15


def known(value):
    return pytest.approx(value, rel=AGREEMENT)


@pytest.fixture(scope='module')
def views():
    return kinect_views()


@pytest.fixture(scope='module')
def measured(views, tmp_path_factory):
    """Measure every view as a recording of one frame."""
    path = tmp_path_factory.mktemp('kinect') / 'view.npz'
    results = []
    for view in views:
        np.savez(
            path,
            depth=view.depth[None],
            amplitude=view.amplitude[None],
            K=view.K,
            stamp=np.zeros(1),
            usecase='kinect_v2',
        )
        results.append(measure(path))
    return results


def test_kinect_views_are_measured_with_their_own_conditions(measured):
    assert len(measured) == 102
    assert all(m.spatial for m in measured)
    assert 0.4 < min(m.distance for m in measured) < max(m.distance for m in measured) < 1.6
    # The camera is not calibrated, its distance was not taped: no bias is claimed.
    assert all(math.isnan(m.bias) and not m.bias_of for m in measured)


def test_kinect_noise_falls_with_the_root_of_amplitude(measured):
    tiles = join([m.tiles for m in measured])
    assert sigma_against(tiles).exponent == known(-0.49)
    edges = np.array([1.0, 1000, 5000, 7000, 20000, 40000, 60000, 66000])
    dark, grey, *bright = sigma_against(tiles, edges).sigma[[0, 2, 4, 5, 6]]
    assert 1e3 * dark == known(4.4)
    assert 1e3 * grey == known(1.7)
    for floor in bright:
        assert 1.1 * (1 - AGREEMENT) < 1e3 * floor < 1.3 * (1 + AGREEMENT)


def test_kinect_neighbours_are_correlated(measured):
    mean = np.mean([0.5 * (m.pixels.right + m.pixels.down) for m in measured])
    assert mean == known(0.66)


def test_kinect_saturates_at_the_top_of_its_scale(views):
    amplitude = np.concatenate([view.amplitude.ravel() for view in views])
    valid = np.concatenate([np.isfinite(view.depth).ravel() for view in views])
    counts = count_invalid(amplitude, valid, np.array([60_000, 65_500, 1e6]))
    below, above = counts.invalid / counts.pixels
    assert below == known(0.066)
    assert above == known(0.97)


def test_azure_has_fixed_pattern_noise():
    """Assert the pattern of two captures of one board, and how alike it makes them."""
    with load('azurekinect_charuco_blackwall.npz') as data:
        depth = np.where(
            data['depth_mm'] > 0, data['depth_mm'] / np.float32(1000), np.float32(np.nan)
        )
    # No calibration came with it: no matrix, so no incidence angles.
    board = find_board(depth[0], 0.001, None, box=(145, 150, 375, 320))
    sums, means = Accumulator(np.nan_to_num(depth[0])), FrameMeans(board.region, depth[0])
    sums.add(depth)
    means.add(depth)
    moments = sums.moments()
    pixels = pixel_statistics(
        board, moments, moments.count == 2, means, np.full(depth[0].shape, len(depth))
    )
    assert 1e3 * pixels.pattern == known(0.9)
    # The second capture is 0.7 mm further away as a whole, which is no noise of the pixels.
    assert 1e3 * pixels.drift == pytest.approx(0.74, abs=0.02)
    assert pixels.frame_spread > 100
    noise = float(np.nanmean(moments.variance[board.region])) - float(means.series.var(ddof=1))
    assert pixels.pattern**2 / (pixels.pattern**2 + noise) == known(0.87)

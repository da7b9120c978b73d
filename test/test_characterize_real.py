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


def test_kinect_white_is_seen_nearer_than_black(views):
    """
    Assert the difference of white and black squares at 0.95 m and 1.2 m.

    By a plane and a step fitted to the squares without their outer tenth. How much of the
    squares' edges is left out matters more than 15 % (amplitudes are blurred there).
    """
    found = []
    for view in views:
        place, _, distance = view.squares
        edge = np.abs(place - np.round(place)).min(axis=0) > 0.1
        inside = (
            (place > -1).all(axis=0)
            & (place[0] < 5)
            & (place[1] < 7)
            & edge
            & np.isfinite(view.depth)
            & (view.amplitude < 65_000)
        )
        odd = np.floor(place).astype(int).sum(axis=0) % 2 == 1
        levels = [
            np.median(view.amplitude[inside & part]) if (inside & part).any() else math.nan
            for part in (odd, ~odd)
        ]
        if not np.isfinite(levels).all():
            continue  # saturated all over
        white = odd if levels[0] > levels[1] else ~odd
        found.append((distance, 1e3 * step_between(view.depth, inside, white)))
    distance, step = np.array(found).T
    near, far = (
        np.median(step[(distance > low) & (distance < high)])
        for low, high in ((0.9, 1.0), (1.1, 1.3))
    )
    assert near == known(-2.7)
    assert far == known(-10.4)


def step_between(depth, inside, white):
    """Fit a plane and a step robustly; return the step, white less black."""
    v, u = np.nonzero(inside)
    design = np.stack([np.ones(len(u)), u, v, white[inside]], axis=1)
    keep = np.ones(len(u), bool)
    for _ in range(10):
        fitted = np.linalg.lstsq(design[keep], depth[inside][keep], rcond=None)[0]
        error = np.abs(depth[inside] - design @ fitted)
        keep = error < 4 * 1.4826 * np.median(error)
    return float(fitted[3])


def test_kinect_bias_is_reported_for_the_nominal_camera_only(views):
    """
    Assert 15 to 21 mm at 0.5 to 0.8 m, falling beyond 1.3 m, with the nominal focal length.

    5 % of focal length are 5 % of the distance by the corners: what is absolute in it is not
    known, which is why the library claims no bias of these views.
    """
    places = [(view, *view.squares[1:]) for view in views]
    bias = np.array([1e3 * np.nanmedian(view.depth - plane) for view, plane, _ in places])
    distance = np.array([distance for *_, distance in places])
    near = np.median(bias[(distance > 0.5) & (distance < 0.8)])
    assert 15 * (1 - AGREEMENT) < near < 21 * (1 + AGREEMENT)
    assert np.median(bias[distance > 1.3]) < near - 4


def test_azure_loses_dark_pixels():
    with load('azurekinect_charuco_blackwall.npz') as data:
        counts = count_invalid(
            data['ir16'].astype(float), data['depth_mm'] > 0, np.array([0.0, 50, 100, 200])
        )
    # Amplitude 0 is no pixel of the scene: it is not counted.
    assert counts.invalid / counts.pixels == known(np.array([0.99, 0.78, 0.25]))


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

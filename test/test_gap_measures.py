"""The physical measures of the gap, on recordings that have little to measure."""

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.gap.data.registration import RecordingData
from flexx2_sim_ros.gap.features.physical import distances, histogram
from flexx2_sim_ros.gap.features.simulation import counts_edges, PlacedScene
from flexx2_sim_ros.gap.inference.improvement import measured
from flexx2_sim_ros.gap.report.words import headline
import numpy as np
import pytest


def recorded(height, width, frames, clean=None):
    """Return a scene, by default a wall 1 m ahead, a recording and a simulation of it."""
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])  # noqa: N806
    clean = np.ones((height, width), np.float32) if clean is None else clean
    stamps = np.arange(frames) * 33_000_000
    depth, simulated = (Camera(seed=seed).capture(clean, K, stamps).depth for seed in (1, 2))
    mode = flexx2().mode('Mode_9_30fps')
    fresh = np.arange(frames) == 0
    recording = RecordingData('', depth, clean, None, K, stamps, fresh, None, mode, None)
    return PlacedScene.at(recording, np.zeros(6)), depth, simulated


def test_errors_at_edges_are_left_out_where_no_effect_is_known_to_cause_them():
    """Assert it for a box whose depth is wrong by 1 cm, at its edges alone."""
    clean = np.ones((60, 80), np.float32)
    clean[20:40, 30:50] = 0.8
    scene, real, simulated = recorded(60, 80, 8, clean)
    there = ~scene.covariates[0].inside
    real[:, there] = simulated[:, there] + 0.01
    whole, surfaces = (
        distances(
            *(
                histogram(depth, scene.covariates, scene.sums(depth), at_edges=at_edges)
                for depth in (real, simulated)
            )
        )
        for at_edges in (True, False)
    )
    assert surfaces['edge_sigma'] == whole['edge_sigma'] > 1
    assert whole['wasserstein_sigma'] > 2 * surfaces['wasserstein_sigma']
    assert surfaces['wasserstein_sigma'] < 0.1
    assert counts_edges({})
    assert counts_edges({'flying_pixels': {}, 'offset': {}})
    assert not counts_edges({'offset': {}})


def test_two_recordings_have_no_interval_of_the_reduction():
    values = np.array([[3.0, 1.0, 0.5], [4.0, 1.0, 0.5], [3.5, 1.2, 0.5]])
    assert measured(values[:2], 1.0)['shrink_interval'] is None
    low, high = measured(values, 1.0)['shrink_interval']
    assert low < measured(values, 1.0)['shrink'] < high


@pytest.mark.parametrize(
    ('names', 'shrink', 'by', 'said'),
    [
        (
            ['pose_error'],
            0.9,
            'distance',
            'The poses of the cameras are wrong: correct them first.',
        ),
        (['offset'], 0.9, 'distance', 'removes 90 % of the gap: depth errors 8.4 -> 2.1 mm.'),
        (['offset'], -0.2, 'distance', 'the gap in depth and invalid pixels becomes 20 % larger'),
        (['offset'], -0.2, 'loss', 'makes the misfit 20 % larger'),
    ],
)
def test_the_headline_promises_no_more_than_was_measured(names, shrink, by, said):
    rows = [{'name': name, 'confidence': 0.9} for name in names]
    depth = {'before': 8.4, 'after': 2.1, 'null': 0.5, 'tolerance': 0.2}
    invalid = {'before': 0.004, 'after': 0.002, 'null': 0.001, 'tolerance': 0.008}
    gap = {'shrink': shrink, 'measured_by': by, 'wasserstein_mm': depth, 'invalid_rate': invalid}
    table = {'verdict': 'identified', 'effects': rows, 'gap': gap}
    assert said in headline(table)

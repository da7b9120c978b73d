"""The noise, re-measured by the paper's own procedure, gives the paper's figures back."""

from boards import board, edge_sigma, mean_kl
from flexx2_sim_ros.camera import Camera, flexx2
import numpy as np
import pytest

MEASURED = {
    'Mode_5_30fps': (0.5, 1.0, 1.5, 2.0),
    'Mode_5_60fps': (0.5, 1.0, 1.5, 2.0),
    'Mode_9_30fps': (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0),
}
ANGLES = (0, 15, 30, 45, 60)
FRAMES = 600


@pytest.mark.parametrize('usecase', MEASURED)
def test_axial_noise_is_the_models_in_every_cell(usecase):
    """
    Assert sigma_z within 3 %, KL within 0.003 nats, and no bias, at all distances and angles.

    False failures: a cell has 600 x 1,600 samples, so its sigma is known to 0.08 % and 3 % is
    beyond 35 standard errors; KL to 6e-5; the bias bound of 5.5 standard errors fails once in
    2.6e7 cells, and there are 80.
    """
    mode = flexx2().mode(usecase)
    for distance in MEASURED[usecase]:
        for angle in ANGLES:
            target = board(distance, angle, size=(40, 40))
            model = mode.noise.sigma_z(target.depth, target.incidence)
            camera = Camera(usecase, seed=11, name=f'{distance}/{angle}')
            stamps = np.arange(FRAMES) * int(1e9 / mode.rate_hz)
            seen = camera.capture(target.depth, target.K, stamps).depth
            # Near the end of the range the noise is cut off by it.
            inside = target.depth + 6 * model < mode.range_max
            assert inside.mean() > 0.5
            samples, clean, sigma = seen[:, inside], target.depth[inside], model[inside]
            realised = np.sqrt(np.mean(samples.astype(np.float64).var(axis=0, ddof=1)))
            cell = f'{usecase} at {distance} m, {angle} deg'
            assert realised == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=0.03), cell
            assert mean_kl(samples, clean, sigma) < 0.003, cell
            score = np.mean((samples - clean) / sigma) * np.sqrt(samples.size)
            assert abs(score) < 5.5, cell


@pytest.mark.parametrize('angle', [0, 15, 30])
@pytest.mark.parametrize('usecase', MEASURED)
def test_edges_move_by_sigma_x(usecase, angle):
    """
    Assert sigma_x within 3 % on a board's left and right edge.

    False failures: 300 frames x 172 rows know sigma to 0.31 % (0.35 % with the rounding's
    kurtosis); 3 % is beyond 8 standard errors.
    """
    mode = flexx2().mode(usecase)
    target = board(1.0, angle, half_width=0.25, background=2.2)
    seen = Camera(usecase, seed=3).capture(target.depth, target.K, np.arange(300)).depth
    row = np.isfinite(target.incidence[86])
    left, right = np.flatnonzero(row)[[0, -1]]
    for edge in (left, right):
        measured = edge_sigma(seen, slice(edge - 14, edge + 15))
        assert measured == pytest.approx(mode.noise.sigma_x, rel=0.03)


def test_level_edges_move_along_columns():
    """Assert the same along columns; false failures as above (300 frames x 224 columns)."""
    target = board(1.0, 15, half_width=0.2, background=2.0, turn='pitch')
    seen = Camera('Mode_9_30fps', seed=3).capture(target.depth, target.K, np.arange(300)).depth
    top = np.flatnonzero(np.isfinite(target.incidence[:, 112]))[0]
    turned = np.swapaxes(seen, 1, 2)
    assert edge_sigma(turned, slice(top - 14, top + 15)) == pytest.approx(1.649, rel=0.03)

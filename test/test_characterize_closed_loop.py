"""What goes into the simulated camera comes out of its characterization."""

from dataclasses import replace

from flexx2_sim_ros.camera import Camera, flexx2, NoiseModel
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.characterize.capture import capture, conditions
from flexx2_sim_ros.profiles.files import load_profile, save_profile, sigma_problem
import numpy as np
import pytest

ANGLES = (0.0, 30.0, 60.0)
DISTANCES = {'Mode_5_30fps': (0.5, 1.0, 1.5, 2.0), 'Mode_9_30fps': (0.75, 1.5, 3.0, 4.5)}
FRAMES = {'Mode_5_30fps': 60, 'Mode_9_30fps': 300}


def measured(folder, profile, usecase, distances, frames):
    """Simulate a campaign and analyse it."""
    wanted = conditions(profile, [usecase], distances, ANGLES)
    done = list(capture(folder, wanted, profile, frames=frames, seed=5))
    assert [new for _, new in done] == [True] * 12
    return characterize(folder)


def worst_ratio(found, true, distances):
    """Return the largest relative deviation of sigma_z on the measured grid."""
    z, theta = np.meshgrid(
        np.linspace(distances[0], distances[-1], 20), np.radians(np.linspace(0, 60, 13))
    )
    return float(np.abs(found.sigma_z(z, theta) / true.sigma_z(z, theta) - 1).max())


@pytest.mark.parametrize('usecase', DISTANCES)
def test_the_papers_coefficients_come_back(usecase, tmp_path):
    """
    Assert sigma_z within 2 %, n within 0.1, sigma_x within 3 %, mean KL at most 0.005 nats.

    (0.005 is for 300 frames, of which 0.0033 are what a perfect model has; fewer frames have
    more, and it is the rest that is compared.)

    False failures: every one of 12 recordings knows sigma_z to 0.3 % or better, so the curve is
    known to less; 2 % is beyond 6 standard errors, also where the curve is least sure (4.5 m and
    60 degrees: 0.3 %). n is known to 0.02. sigma_x is the largest but one of ten or more edges,
    each known to 1 %: some 1 % high, 3 % is beyond 6 standard errors of a percentile of edges.
    """
    distances, frames = DISTANCES[usecase], FRAMES[usecase]
    true = flexx2().mode(usecase).noise
    result = measured(tmp_path, flexx2(), usecase, distances, frames)
    assert not result.left_out
    mode = result.mode(usecase)
    assert len(mode.cells) == 12
    fit = mode.axial
    assert worst_ratio(fit.model(), true, distances) < 0.02
    assert fit.coefficients['n'] == pytest.approx(2.7, abs=0.1)
    assert fit.interval_n[1] - fit.interval_n[0] < 0.4
    assert mode.sigma_x == pytest.approx(true.sigma_x, rel=0.03)
    assert len(mode.edges) >= 8
    raw = np.mean([cell.axial.raw for cell in mode.cells])
    floor = np.mean([cell.axial.floor for cell in mode.cells])
    assert floor == pytest.approx(1 / frames, rel=0.02)
    assert raw - floor < 0.005 - 1 / 300
    if frames == 300:
        assert raw <= 0.005
    lateral = [cell.lateral for cell in mode.cells if cell.lateral is not None]
    assert abs(np.mean([kl.debiased for kl in lateral])) < 0.003


def test_another_cameras_coefficients_come_back(tmp_path):
    """
    Assert the same of coefficients drawn at random; and that the profile runs as that camera.

    False failures: as above.
    """
    generator = np.random.default_rng(1)
    distances = DISTANCES['Mode_9_30fps']
    while True:
        true = NoiseModel(
            *(
                float(x)
                for x in generator.uniform(
                    (0.001, -0.002, 0.0002, 0.0001), (0.008, 0.002, 0.002, 0.0006)
                )
            ),
            round(float(generator.uniform(0.5, 2.5)), 1),
            float(generator.uniform(0.7, 1.8)),
        )
        if (
            sigma_problem(true, 0.1, 7.0) is None
            and true.sigma_z(np.linspace(0.1, 7.0, 50), 0.0).min() > 0.0005
        ):
            break
    mode = replace(flexx2().mode('Mode_9_30fps'), noise=true)
    camera = replace(flexx2(), model='Other', modes=(mode,))
    result = measured(tmp_path, camera, mode.name, distances, 60)
    found = result.modes[0]
    assert worst_ratio(found.axial.model(), true, distances) < 0.02
    low, high = found.axial.interval_n
    assert abs(found.axial.coefficients['n'] - true.n) < 0.11 or low <= true.n <= high
    assert found.sigma_x == pytest.approx(true.sigma_x, rel=0.03)

    save_profile(tmp_path / 'profile.yaml', to_profile(result, 'Other'))
    loaded = load_profile(tmp_path / 'profile.yaml')
    assert loaded.intrinsics == camera.intrinsics
    scene = np.full((60, 80), 2.0, np.float32)
    matrix = np.array([[210.6, 0, 39.5], [0, 212.9, 29.5], [0, 0, 1]])
    one, other = (
        Camera(mode.name, profile=profile).capture(scene, matrix, 0).sigma
        for profile in (camera, loaded)
    )
    np.testing.assert_allclose(one, other, rtol=0.02)

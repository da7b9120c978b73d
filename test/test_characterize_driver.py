"""Noise from bags that the vendor's driver writes."""

from pathlib import Path

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.physics.geometry import pixel_rays
from made_bags import DISTORTION, driver_bag, MATRIX
import numpy as np
import pytest


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_real_drivers_bags_give_its_noise(tmp_path: Path, storage: str) -> None:
    """
    Assert distance, incidence and sigma_z from the driver's topics, through its lens.

    False failures: 30,000 pixels of 12 frames know sigma to 0.12 %, the angle to 0.01 degrees.
    """
    camera = Intrinsics.from_matrix(MATRIX, 224, 172, DISTORTION)
    x, y = pixel_rays(camera)
    generator = np.random.default_rng(3)
    sigma = 0.004
    for distance, angle in ((0.8, 0), (1.0, 30), (1.4, 45)):
        clean = distance / (1 - np.tan(np.radians(angle)) * x)
        depth = clean + sigma * generator.standard_normal((12, *clean.shape))
        depth[generator.random(depth.shape) < 0.01] = 0.0  # no light came back
        driver_bag(
            tmp_path / f'Mode_5_45fps_{distance:.2f}m_{angle}deg',
            depth.astype(np.float32),
            storage,
        )
    result = characterize(tmp_path)
    assert not result.left_out
    profile = to_profile(result).profile
    assert (profile.model, profile.names) == ('Flexx2', ['Mode_5_45fps'])
    assert profile.intrinsics == camera
    for cell in result.modes[0].cells:
        m = cell.measurement
        assert m.condition is not None
        assert m.distance == pytest.approx(m.condition.distance, abs=0.001)
        assert m.angle_deg == pytest.approx(m.condition.angle_deg, abs=0.1)
        assert cell.sigma == pytest.approx(sigma, rel=0.01)
        assert m.pixels.invalid == pytest.approx(0.01, abs=0.002)
        # Without the lens the plane would be bent by 3 mm and more.
        assert m.pixels.flatness < 0.0003
        assert m.rate_hz == pytest.approx(45.0, rel=1e-3)
        assert m.amplitude is not None

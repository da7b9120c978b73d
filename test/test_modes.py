"""The nine modes and the paper's noise model."""

import math
import shutil

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles import modes
import numpy as np
import pytest

# The paper's tables: a, b, c, d, n, sigma_x.
PAPER = {
    'Mode_5_30fps': (0.002362, -0.001041, 0.000753, 0.000185, 2.7, 0.864),
    'Mode_5_60fps': (0.002209, -0.000793, 0.001418, 0.000370, 2.7, 1.098),
    'Mode_9_30fps': (0.002345, -0.002101, 0.001824, 0.000298, 2.7, 1.649),
}
# Rate, range, the mode whose noise it takes.
MODES = {
    'Mode_5_15fps': (15, 2.4, 'Mode_5_30fps'),
    'Mode_5_30fps': (30, 2.4, 'Mode_5_30fps'),
    'Mode_5_45fps': (45, 2.4, 'Mode_5_60fps'),
    'Mode_5_60fps': (60, 2.4, 'Mode_5_60fps'),
    'Mode_9_5fps': (5, 7.0, 'Mode_9_30fps'),
    'Mode_9_10fps': (10, 7.0, 'Mode_9_30fps'),
    'Mode_9_15fps': (15, 7.0, 'Mode_9_30fps'),
    'Mode_9_20fps': (20, 7.0, 'Mode_9_30fps'),
    'Mode_9_30fps': (30, 7.0, 'Mode_9_30fps'),
}
IMAGE = np.full((4, 5), 1.0)
K = np.array([[210.6, 0.0, 111.5], [0.0, 212.9, 85.5], [0.0, 0.0, 1.0]])


def test_the_nine_modes_in_the_drivers_order():
    assert flexx2().names == list(MODES)
    assert flexx2().model == 'Flexx2'


@pytest.mark.parametrize('name', MODES)
def test_the_table(name):
    mode = flexx2().mode(name)
    rate, range_max, noise_of = MODES[name]
    assert (mode.rate_hz, mode.range_min, mode.range_max) == (rate, 0.1, range_max)
    assert mode.noise_of == noise_of
    assert mode.measured == (name in PAPER)
    noise = mode.noise
    assert (noise.a, noise.b, noise.c, noise.d, noise.n, noise.sigma_x) == PAPER[noise_of]
    assert mode.raw_frames == (5 if name.startswith('Mode_5') else 9)
    assert mode.modulation_hz == ((60e6,) if name.startswith('Mode_5') else (80e6, 60e6))
    shortest, longest = mode.exposure_us
    assert 0 < shortest < longest
    # All raw exposures fit into the frame.
    assert mode.raw_frames * longest * 1e-6 < 1 / mode.rate_hz
    assert mode.source


def test_the_cameras_intrinsics():
    intrinsics = flexx2().intrinsics
    assert (intrinsics.width, intrinsics.height) == (224, 172)
    assert (intrinsics.cx, intrinsics.cy) == (111.5, 85.5)
    assert math.degrees(2 * math.atan(112 / intrinsics.fx)) == pytest.approx(56)
    assert math.degrees(2 * math.atan(86 / intrinsics.fy)) == pytest.approx(44)


@pytest.mark.parametrize('name', PAPER)
def test_sigma_z_is_the_papers_formula(name):
    mode = flexx2().mode(name)
    a, b, c, d, n, _ = PAPER[name]
    for z in np.linspace(0.1, mode.range_max, 7):
        for theta in np.radians([0, 15, 30, 45, 60, 80]):
            slant = theta**2 / (math.pi / 2 - theta) ** 2
            wanted = a + b * z + c * z**2 + d * z**n * slant
            assert float(mode.noise.sigma_z(z, theta)) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize('name', PAPER)
def test_sigma_z_is_positive_capped_and_grows_with_the_angle(name):
    mode = flexx2().mode(name)
    z = np.linspace(mode.range_min, mode.range_max, 400)[:, None]
    sigma = mode.noise.sigma_z(z, np.radians(np.linspace(0, 90, 361)))
    assert sigma.shape == (400, 361)
    assert np.isfinite(sigma).all()
    assert (sigma > 0).all()
    assert (np.diff(sigma, axis=1) >= 0).all()
    # Held near 90 degrees, beyond every angle that was measured.
    np.testing.assert_array_equal(sigma[:, -1], sigma[:, -2])
    assert (np.diff(sigma, axis=1)[:, 240:320] > 0).all()


def test_sigma_z_never_goes_below_zero_and_keeps_nan():
    falling = modes.NoiseModel(0.001, -0.01, 0.0, 0.0, 2.7, 1.0)
    np.testing.assert_array_equal(falling.sigma_z([0.0, 1.0, 5.0], 0.0), [0.001, 0.0, 0.0])
    assert np.isnan(falling.sigma_z(math.nan, 0.0))
    assert np.isnan(falling.sigma_z(1.0, math.nan))


@pytest.mark.parametrize('spelling', ['mode_9_5fps', 'MODE_9_5FPS', ' Mode_9_5fps\n'])
def test_names_are_found_whatever_their_case(spelling):
    assert flexx2().mode(spelling).name == 'Mode_9_5fps'


@pytest.mark.parametrize('name', ['', 'Mode_9', 'Mode_9_30', 'MODE 9 30FPS', None, 5, b'x', 'é'])
def test_an_unknown_name_is_answered_with_the_valid_ones(name):
    for ask in (flexx2().mode, Camera):
        with pytest.raises(InputError) as error:
            ask(name)
        assert repr(name) in str(error.value)
        assert all(valid in str(error.value) for valid in MODES)


@pytest.fixture
def config(tmp_path, monkeypatch):
    for name in ('modes.yaml', 'flexx2.yaml'):
        shutil.copy(config_dir() / name, tmp_path)
    monkeypatch.setattr(modes, 'config_dir', lambda: tmp_path)
    flexx2.cache_clear()
    modes._camera_config.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    flexx2.cache_clear()
    modes._camera_config.cache_clear()


def test_a_valid_configuration_is_used(config):
    text = (config / 'modes.yaml').read_text()
    (config / 'modes.yaml').write_text(text.replace('sigma_x: 0.864', 'sigma_x: 0.5'))
    assert flexx2().mode('Mode_5_30fps').noise.sigma_x == 0.5


@pytest.mark.parametrize(
    ('file', 'old', 'new', 'named'),
    [
        ('modes.yaml', 'rate_hz: 15,', '', 'rate_hz'),
        ('modes.yaml', 'range_m: [0.1, 2.4]', 'range_m: 2.4', 'modes.yaml'),
        ('modes.yaml', 'a: 0.002362, ', '', "'a'"),
        ('modes.yaml', 'noise: Mode_5_30fps', 'noise: Mode_7', 'Mode_7'),
        ('modes.yaml', 'schema: 1', 'schema: 99', 'schema'),
        ('flexx2.yaml', 'width: 224', 'width: -1', 'width'),
        ('flexx2.yaml', 'incidence_cap_deg: 85.0', 'incidence_cap_deg: 90', 'incidence_cap_deg'),
        ('flexx2.yaml', 'field_of_view_deg: [56, 44]', 'field_of_view_deg: 56', 'flexx2.yaml'),
        ('flexx2.yaml', 'jump_share: 0.01', 'jump_share: small', 'jump_share'),
        ('flexx2.yaml', 'neighbourhood_px: 8', 'neighbour: 8', 'neighbourhood_px'),
    ],
)
def test_a_malformed_configuration_is_named(config, file, old, new, named):
    text = (config / file).read_text()
    assert old in text
    (config / file).write_text(text.replace(old, new))
    with pytest.raises(InputError, match=named):
        Camera().capture(IMAGE, K, 0)


def test_a_missing_file_is_named(config):
    (config / 'flexx2.yaml').unlink()
    with pytest.raises(InputError, match=r'flexx2\.yaml'):
        Camera()

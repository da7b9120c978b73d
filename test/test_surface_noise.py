"""Noise that depends on reflectivity: in the camera, in a batch, and measured with boards."""

from dataclasses import replace

from batches import DEVICES
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.camera import Camera, flexx2, Profile
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.characterize.capture import capture, conditions
from flexx2_sim_ros.characterize.noise_report import write_report
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.files import load_profile, ProfileFile, save_profile
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import SurfaceNoise
import numpy as np
import pytest
import warp as wp

USECASE = 'Mode_9_30fps'
PLANTED = SurfaceNoise(0.9, 0.25, 0.4)
STEEP = SurfaceNoise(0.9, 0.0, 1.0)
K = np.array([[210.0, 0.0, 55.5], [0.0, 212.0, 42.5], [0.0, 0.0, 1.0]])
SIZE = 86, 112


def camera_with(surfaces):
    """Return the middle of the Flexx2's image in Mode_9_30fps, with noise of surfaces or not."""
    mode = flexx2().mode(USECASE)
    mode = replace(mode, noise=replace(mode.noise, surfaces=surfaces))
    lens = Intrinsics(SIZE[1], SIZE[0], 210.0, 212.0, 55.5, 42.5)
    return Profile('Crop', lens, (mode,))


def striped():
    """Return a slanted wall with a step, and reflectivity from 0 to 1 in stripes."""
    depth = np.linspace(0.8, 4.0, SIZE[1], dtype=np.float32) * np.ones((SIZE[0], 1), np.float32)
    depth[30:, 60:] += 0.4
    rho = np.repeat([0.0, 0.05, 0.2, 0.5, 0.9, 1.0, np.nan], 16)[: SIZE[1]]
    return depth, np.broadcast_to(rho, SIZE).astype(np.float32)


@pytest.mark.parametrize('effects', [{}, {'offset': {'bias': 0.01}}])
def test_without_the_section_reflectivity_changes_no_depth(effects):
    depth, rho = striped()
    camera = Camera(USECASE, profile=camera_with(None), effects=effects, seed=3)
    other = Camera(USECASE, profile=camera_with(PLANTED), effects=effects, seed=3)
    plain = camera.capture(depth, K, 5)
    np.testing.assert_array_equal(camera.capture(depth, K, 5, rho).depth, plain.depth)
    # No reflectivity: the white board, whatever the profile says.
    np.testing.assert_array_equal(other.capture(depth, K, 5).depth, plain.depth)


def test_darker_surfaces_are_noisier_as_light_says():
    """All of read noise: sigma as 1 / A; all of shot noise: as 1 / sqrt(A); constant: the same."""
    depth = np.full(SIZE, 1.0, np.float32)
    for constant, read, wanted in ((0, 1, 9.0), (0, 0, 3.0), (1, 0.5, 1.0)):
        surfaces = SurfaceNoise(0.9, constant, read)
        camera = Camera(USECASE, profile=camera_with(surfaces))
        paints = (np.full(SIZE, rho, np.float32) for rho in (0.9, 0.1))
        white, dark = (camera.capture(depth, K, 0, rho).sigma[40, 50] for rho in paints)
        assert dark / white == pytest.approx(wanted, rel=1e-4)
        assert white == camera.capture(depth, K, 0).sigma[40, 50]


def test_both_paths_and_the_batch_agree():
    depth, rho = striped()
    profile = camera_with(PLANTED)
    one, staged = (
        Camera(USECASE, profile=profile, seed=3, effects=effects).capture(depth, K, 0, rho)
        for effects in ({}, {'offset': {'bias': 1e-9}})
    )
    for image, other in ((one.depth, staged.depth), (one.sigma, staged.sigma)):
        np.testing.assert_allclose(image, other, rtol=1e-5)
    batch = BatchCamera(2, USECASE, profile=profile, K=K, seed=[3, 4], device='cpu')
    found = batch(np.stack([depth] * 2), np.stack([rho] * 2))
    np.testing.assert_allclose(found[0], one.depth, rtol=1e-4)
    plain = Camera(USECASE, profile=profile, seed=4).capture(depth, K, 0).depth
    assert not np.array_equal(found[1], plain, equal_nan=True)


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('first', ['white', 'dark'])
def test_a_captured_graph_follows_changes_of_mode(first, device):
    """Assert it of modes whose noise depends on reflectivity in different ways, or not at all."""
    profile = camera_with(PLANTED)
    (mode,) = profile.modes
    modes = [
        replace(mode, name=name, noise=replace(mode.noise, surfaces=surfaces))
        for name, surfaces in (('white', None), ('dark', PLANTED), ('darker', STEEP))
    ]
    profile = replace(profile, modes=tuple(modes))
    options = {'profile': profile, 'K': K, 'seed': [3, 4], 'device': device}
    one, other = (BatchCamera(2, first, **options) for _ in range(2))
    scene = [wp.array(np.stack([image] * 2), device=device) for image in striped()]
    seen, wanted = one(*scene), other(*scene)
    with wp.ScopedCapture(device) as capture:
        one(*scene)
    for mode in modes:
        for camera in (one, other):
            camera.set_usecase(mode.name, np.array([False, True]))
        wp.capture_launch(capture.graph)
        other(*scene)
        np.testing.assert_array_equal(seen.numpy(), wanted.numpy())
        alone = Camera(mode.name, seed=4, profile=profile)
        stamp = int(other.image_stamps.numpy()[1])
        depth = alone.capture(striped()[0], K, stamp, striped()[1]).depth
        np.testing.assert_allclose(seen.numpy()[1], depth, rtol=1e-4)


def test_the_section_is_read_back_and_checked(tmp_path):
    path = tmp_path / 'profile.yaml'
    errors = {USECASE: {'read_share': 0.02}}
    save_profile(path, ProfileFile(camera_with(PLANTED), errors))
    assert load_profile(path).mode(USECASE).noise.surfaces == PLANTED
    text = path.read_text()
    path.write_text(text.replace('read_share: 0.4', 'read_share: 1.4'))
    with pytest.raises(InputError, match=r'surfaces\.read_share: must be a number from 0 to 1'):
        load_profile(path)


def test_three_boards_give_the_dependence_back(tmp_path):
    """
    Assert the planted shares within their standard errors, and that these are of the right size.

    False failures: sigma is known to 0.1 % in each of 24 recordings (60 frames of 9,000 pixels),
    which makes 0.004 of either share: 0.03 is beyond 7 of these. Student's t of 14 degrees of
    freedom (16 recordings of darker boards, two shares) is beyond 10 with a probability of 1e-7.
    """
    wanted = conditions(camera_with(PLANTED), None, (0.5, 0.8, 1.2, 1.6), (0.0, 30.0), (90, 30, 8))
    assert len(wanted) == 24
    assert wanted[1].name == f'{USECASE}_0.50m_0deg_30pct'
    boards = tmp_path / 'boards'
    for _ in capture(boards, wanted, camera_with(PLANTED), frames=60, seed=5):
        pass
    result = characterize(boards)
    (mode,) = result.modes
    assert mode.surfaces is not None
    for name in ('constant_share', 'read_share'):
        error = mode.surfaces.errors[name]
        assert error is not None
        assert 0 < error < 0.03
        found = getattr(mode.surfaces.noise, name)
        assert abs(found - getattr(PLANTED, name)) < min(10 * error, 0.03)
    profile = to_profile(result, 'Crop')
    save_profile(tmp_path / 'profile.yaml', profile)
    noise = load_profile(tmp_path / 'profile.yaml').mode(USECASE).noise
    true = camera_with(PLANTED).mode(USECASE).noise
    for rho in (0.9, 0.3, 0.08):
        z = np.array([0.7, 1.5, 3.0])
        wanted = true.sigma_z(z, 0.3, rho)
        np.testing.assert_allclose(noise.sigma_z(z, 0.3, rho), wanted, rtol=0.05)
    page = write_report(result, profile, tmp_path).read_text()
    assert 'Noise and reflectivity' in page
    assert 'one white board' not in page


def test_one_board_leaves_the_dependence_off_and_reports_it(tmp_path, capsys):
    profile = tmp_path / 'camera.yaml'
    save_profile(profile, ProfileFile(camera_with(PLANTED)))
    wanted = conditions(camera_with(None), [USECASE], (0.8, 1.6), (0.0, 40.0))
    for _ in capture(tmp_path / 'boards', wanted, camera_with(None), frames=10):
        pass
    out = tmp_path / 'out'
    call = ['characterize', 'fit', str(tmp_path / 'boards'), '--out', str(out), '--jobs', '1']
    assert main([*call, '--profile', str(profile)]) == 0
    assert load_profile(out / 'profile.yaml').mode(USECASE).noise.surfaces is None
    assert 'Assumed: one white board' in (out / 'report.html').read_text()
    assert 'noise of the white board' in (out / 'profile.yaml').read_text().replace('\n', ' ')
    plan = ['characterize', 'plan', '--usecase', USECASE, '--reflectivities', '90', '30', '8']
    capsys.readouterr()
    assert main([*plan, '--distances', '1', '--angles', '0']) == 0
    said = capsys.readouterr().out
    assert f'- [ ] `{USECASE}_1.00m_0deg_30pct`' in said
    assert '90 %, 30 %, 8 %' in said

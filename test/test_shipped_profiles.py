"""Cameras other than the Flexx2, by name: simulated, measured, diagnosed, run by the nodes."""

from dataclasses import replace
import json

from bench.exposure import noise_by_exposure
from bench.wall_campaigns import wall
from campaigns import leaving
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.cli.demo import as_seen, draw
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import centred, pixel_rays
from flexx2_sim_ros.profiles.files import (
    find_profile,
    load_profile,
    ProfileFile,
    save_profile,
    shipped,
)
from flexx2_sim_ros.profiles.valid_mask import mask_of
from matplotlib.image import imread, imsave
import numpy as np
import pytest

SOURCES = {'kinect_v2': 'measured', 'azure_kinect_nfov': 'assumed', 'realsense_d435': 'data_sheet'}
SIZE = 48, 64
K = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 23.5], [0.0, 0.0, 1.0]])
BOARDS = ((0.6, 5), (0.9, 40), (1.3, 10), (1.8, 45), (2.2, 20), (2.6, 0))
FACTOR = 1.5


def record(folder, name, frames, *more):
    """Simulate walls with a shipped profile, by the command line."""
    recordings = folder / 'recordings'
    recordings.mkdir()
    for i, (distance, angle) in enumerate(BOARDS):
        scene = folder / f'scene{i}.npz'
        np.savez(scene, clean_depth=wall(distance, angle, K, SIZE), K=K)
        out = str(recordings / f'wall{i}.npz')
        call = ['simulate', str(scene), out, '--profile', name, '--frames', str(frames), *more]
        assert main(call) == 0
    return recordings


def test_names_are_listed_and_found(capsys):
    assert set(shipped()) == {'flexx2', 'flexx2_exposure', *SOURCES}
    assert find_profile('') is find_profile('Flexx2') is flexx2()
    with pytest.raises(InputError, match='profile: must be one of flexx2, azure.* got kinekt'):
        find_profile('kinekt')
    assert main(['modes', '--profile', 'realsense_d435']) == 0
    said = capsys.readouterr().out
    assert 'RealSense D435, a stereo camera' in said
    assert 'depth_848x480_30fps' in said
    assert main(['modes', '--profile', '/no/such.yaml']) == 2
    assert '/no/such.yaml' in capsys.readouterr().err


@pytest.mark.parametrize(('name', 'source'), SOURCES.items())
def test_a_profile_says_where_its_noise_comes_from(name, source, tmp_path, capsys):
    (mode,) = find_profile(name).modes
    assert mode.noise_from == source
    assert mode.measured == (source == 'measured')
    assert main(['modes', '--profile', name]) == 0
    said = capsys.readouterr().out
    assert ('itself' if mode.measured else f'{source.replace("_", " ")}*') in said
    np.savez(tmp_path / 'scene.npz', clean_depth=wall(1.0, 0, K, SIZE), K=K)
    out = str(tmp_path / 'out.npz')
    assert main(['simulate', str(tmp_path / 'scene.npz'), out, '--profile', name]) == 0
    assert ('was not measured' in capsys.readouterr().err) != mode.measured


def test_stereo_noise_is_the_disparity_noise():
    """Subpixel error 0.08 px, focal length 424 px, baseline 50 mm."""
    (mode,) = find_profile('realsense_d435').modes
    z = np.array([0.5, 1.0, 2.0, 4.0])
    np.testing.assert_allclose(mode.noise.sigma_z(z, 0), z**2 * 0.08 / (424 * 0.05), rtol=1e-4)


def test_boards_give_the_profile_back(tmp_path):
    """Six boards, 60 frames of 3,000 pixels: sigma is known to well below 1 % at each board."""
    name, out = 'kinect_v2', tmp_path / 'result'
    recordings = record(tmp_path, name, 60)
    call = ['characterize', 'fit', str(recordings), '--profile', name, '--out', str(out)]
    assert main([*call, '--jobs', '1']) == 0
    camera, measured = find_profile(name), load_profile(out / 'profile.yaml')
    assert measured.model == camera.model
    assert measured.sensor.kind == camera.sensor.kind
    (mode,), (found,) = camera.modes, measured.modes
    assert found.modulation_hz == mode.modulation_hz
    z = np.array([0.7, 1.0, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(found.noise.sigma_z(z, 0), mode.noise.sigma_z(z, 0), rtol=0.05)


def test_excess_noise_of_a_stereo_camera_is_diagnosed(tmp_path):
    name = 'realsense_d435'
    effects = tmp_path / 'effects.yaml'
    effects.write_text(f'schema: 1\neffects: {{excess_noise: {{factor: {FACTOR}}}}}\n')
    recordings = record(tmp_path, name, 10, '--effects', str(effects))
    out = tmp_path / 'out'
    call = ['gap', 'diagnose', str(recordings), '--profile', name, '--out', str(out)]
    phases = {name for name, kind in registry().items() if kind.needs_modulation}
    kept = {'excess_noise', 'heavy_tails', 'offset', 'pose_error', *phases}
    assert main([*call, '--jobs', '1', '--forms', 'catalogue', *leaving(*kept)]) == 0
    table = json.loads((out / 'diagnosis.json').read_text())
    rows = [row for row in table['not_considered'] if row['name'] in kept]
    left_out = {row['name']: row['reason'] for row in rows}
    assert left_out == dict.fromkeys(phases, 'does not apply to a stereo camera')
    assert [effect['name'] for effect in table['effects']] == ['excess_noise']
    assert table['effects'][0]['parameters']['factor'] == pytest.approx(FACTOR, rel=0.05)
    assert table['gap']['shrink'] > 0.8


def test_a_robots_cameras_are_rendered_with_its_intrinsics(ros):
    from flexx2_sim_ros.nodes.robot_node import RobotCameras
    from rclpy.parameter import Parameter

    camera = find_profile('kinect_v2').intrinsics
    node = RobotCameras(parameter_overrides=[Parameter('profile', value='kinect_v2')])
    try:
        rendered = node._intrinsics
        assert (rendered.fx, rendered.fy) == (camera.fx, camera.fy)
        assert rendered.width >= camera.width
        assert rendered.height >= camera.height
    finally:
        node.destroy_node()


@pytest.mark.parametrize('name', ['flexx2', 'kinect_v2'])
def test_the_demo_compares_depth_in_the_pixels_of_the_camera(name, tmp_path):
    profile = find_profile(name)

    def slope(camera):
        x, y = pixel_rays(camera)
        return (1.5 / (1 + 0.2 * x + 0.1 * y)).astype(np.float32)

    camera = profile.intrinsics
    clean, seen = slope(centred(camera)), slope(camera)
    # A lens without distortion and with its axis in the middle is rendered as it is.
    assert (clean.shape == seen.shape) == (name == 'flexx2')
    np.testing.assert_allclose(as_seen(clean, profile), seen, atol=1e-4)
    mode = profile.modes[0]
    draw(tmp_path / 'demo.png', {('front_left', mode.name): (clean, seen)}, [mode], profile)
    assert imread(tmp_path / 'demo.png').std() > 0.1


def test_no_depth_outside_the_valid_region():
    """The region is a matter of rays, so that a crop at another resolution has the same one."""
    camera = find_profile('azure_kinect_nfov')
    whole = camera.sensor.outside(camera.intrinsics)
    assert whole[0, 0]
    assert whole[-1, -1]
    assert not whole[288, 320]
    small = camera.intrinsics.matrix * [[0.25], [0.25], [1]]
    scene = np.full((144, 160), 1.5, np.float32)
    frames = {}
    for effects in ({}, {'offset': {'bias': 0.005}}):
        options = {'profile': camera, 'effects': effects}
        frame = Camera(camera.default_usecase, **options).capture(scene, small, 0)
        lost = np.isnan(frame.depth)
        assert lost.mean() == pytest.approx(whole.mean(), abs=0.01)
        assert np.isnan(frame.sigma[lost]).all()
        assert not frame.amplitude[lost].any()
        assert not frame.confidence[lost].any()
        assert (frame.confidence[~lost] > 0).all()
        batch = BatchCamera(1, camera.default_usecase, K=small, **options)
        np.testing.assert_array_equal(np.isnan(batch(scene[None].copy())[0]), lost)
        frames[bool(effects)] = lost
    np.testing.assert_array_equal(frames[False], frames[True])


def test_noise_that_follows_exposure():
    """Predictions for the unmeasured modes from the measured pair; the rest is the Flexx2's."""
    by_exposure, nearest = find_profile('flexx2_exposure'), flexx2()
    assert by_exposure.intrinsics == nearest.intrinsics
    assert by_exposure.sensor == nearest.sensor
    for mode, own in zip(by_exposure.modes, nearest.modes, strict=True):
        noise = own.noise if own.measured else mode.noise
        assert replace(mode, noise_of=own.noise_of, source=own.source) == replace(own, noise=noise)
        row = noise_by_exposure(mode.name)
        assert {key: getattr(mode.noise, key) for key in row} == row
    z = np.array([0.3, 0.7, 1.0, 1.5, 2.0, 2.4])
    table = {
        'Mode_5_45fps': [2.11, 2.15, 2.42, 3.31, 4.76, 6.32],
        'Mode_5_15fps': [2.12, 1.91, 1.84, 1.86, 1.97, 2.13],
    }
    for usecase, wanted in table.items():
        found = 1e3 * by_exposure.mode(usecase).noise.sigma_z(z, 0)
        np.testing.assert_allclose(found, wanted, rtol=0.025)
    modes = [by_exposure.mode(f'Mode_9_{rate}fps') for rate in (5, 10, 15, 20, 30)]
    assert (np.diff([mode.noise.sigma_z(5.0, 0.5) for mode in modes]) > 0).all()


@pytest.mark.parametrize('suffix', ['.npy', '.png', '.PNG'])
def test_a_mask_says_which_pixels_have_depth(suffix, tmp_path):
    """A ring: no polygon. It holds for a crop, and the profile that is saved has it."""
    camera = find_profile('kinect_v2')
    v, u = np.mgrid[: camera.intrinsics.height, : camera.intrinsics.width]
    radius = np.hypot(u - 256, v - 212)
    valid = (radius < 200) & (radius > 40)
    path = tmp_path / 'camera.yaml'
    save_profile(path, ProfileFile(camera))
    if suffix == '.npy':
        np.save(tmp_path / 'ring.npy', valid)
    else:
        imsave(tmp_path / f'ring{suffix}', valid, cmap='gray', format='png')
    text = path.read_text().replace('valid_mask: null', f'valid_mask: ring{suffix}')
    path.write_text(text)
    masked = load_profile(path)
    clean = np.full(valid.shape, 1.5, np.float32)
    matrix = camera.intrinsics.matrix
    seen = Camera(camera.default_usecase, profile=masked).capture(clean, matrix, 0).depth
    np.testing.assert_array_equal(np.isfinite(seen), valid)
    crop = matrix - [[0, 0, 200], [0, 0, 150], [0, 0, 0]]
    seen = Camera(camera.default_usecase, profile=masked).capture(clean[:90, :80], crop, 0).depth
    np.testing.assert_array_equal(np.isfinite(seen), valid[150:240, 200:280])
    save_profile(tmp_path / 'again.yaml', ProfileFile(masked))
    assert load_profile(tmp_path / 'again.yaml').sensor == masked.sensor
    np.save(tmp_path / 'ring.npy', valid[:-1])
    path.write_text(text.replace(suffix, '.npy'))
    with pytest.raises(InputError, match=r'sensor\.valid_mask: .*the size of the profile'):
        load_profile(path)
    (tmp_path / 'ring.npy').unlink()
    with pytest.raises(InputError, match=r'valid_mask: .*ring\.npy: must be an existing'):
        load_profile(path)


@pytest.mark.parametrize('size', [(320, 240), (512, 424)])
def test_a_mask_of_another_image_is_saved_for_the_profiles_own(size, tmp_path):
    """Assert that camera and file allow the same pixels, as rays tell."""
    camera = find_profile('kinect_v2')
    own = replace(camera.intrinsics.resized(*size), cx=size[0] / 2 + 5)
    image = np.random.default_rng(0).uniform(size=size[::-1]) < 0.7
    masked = with_mask(camera, mask_of(image, own))
    save_profile(tmp_path / 'camera.yaml', ProfileFile(masked))
    kept = load_profile(tmp_path / 'camera.yaml')
    wanted = masked.sensor.outside(camera.intrinsics)
    assert 0.2 < wanted.mean() < 0.5
    found = kept.sensor.outside(camera.intrinsics)
    np.testing.assert_array_equal(found, wanted)


def with_mask(camera, mask):
    """Return a camera with a mask of valid pixels in all its modes."""
    sensor = replace(camera.sensor, valid_mask=mask)
    return replace(camera, modes=tuple(replace(mode, sensor=sensor) for mode in camera.modes))

"""From hand-made files of an unknown camera to a diagnosis, by the documented commands."""

import json

from campaigns import leaving
import cv2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.profiles.files import load_profile
from flexx2_sim_ros.recording import load_recording
from made_images import save
import numpy as np
import pytest
from scipy import ndimage
import yaml

SIZE = 72, 96
K = np.array([[75.0, 0.0, 47.5], [0.0, 75.0, 35.5], [0.0, 0.0, 1.0]])
# Of an Azure Kinect: the two polynomials nearly cancel.
LENS = np.array([2.09, 1.36, 1e-4, -2e-5, 0.07, 2.42, 2.05, 0.37])
BOARDS = (0.6, 5), (0.9, 40), (1.3, 10), (1.8, 45), (2.2, 20)
WALLS = (0.7, 10), (0.9, -30), (1.1, 2), (1.4, 35), (1.6, -20), (1.8, 5)
HIDDEN = np.s_[45:, 66:]  # A part of the robot is in view there.
Z = np.array([0.7, 1.3, 2.0])
KEPT = 'offset', 'depth_scale', 'amplitude_bias', 'spatial_filter', 'excess_noise', 'quantisation'
KEPT += 'fixed_pattern', 'heavy_tails', 'intrinsics_error', 'pose_error'


def sigma_z(z):
    """Return the camera's noise, metres."""
    return 0.001 + 0.0015 * z**2


def wall(distance, angle_deg):
    """Return (H, W) metres of a wall at a distance along its normal, turned about the vertical."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    enough = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    x = cv2.undistortPoints(pixels, K, LENS, criteria=enough)[:, 0, 0].reshape(SIZE)
    turn = np.radians(angle_deg)
    return np.asarray(distance / (np.cos(turn) + x * np.sin(turn)))


def millimetres(clean, frames, rng, blur=0.0):
    """Return (T, H, W) uint16 frames; a blur of 0.85 px correlates neighbours by 0.7."""
    noise = rng.standard_normal((frames, *SIZE))
    noise = ndimage.gaussian_filter(noise, (0, blur, blur), mode='wrap')
    depth = clean + sigma_z(clean) * noise / noise.std()
    depth[:, *HIDDEN] = 0.15 + 0.05 * rng.random(depth[:, *HIDDEN].shape)
    return np.rint(1000 * depth).astype(np.uint16)


def write_lens_and_mask(folder):
    """Write ``ost.yaml`` of camera_calibration, and ``mask.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    calibration = {
        'image_width': SIZE[1],
        'image_height': SIZE[0],
        'camera_matrix': {'data': K.ravel().tolist()},
        'distortion_model': 'rational_polynomial',
        'distortion_coefficients': {'data': LENS.tolist()},
    }
    (folder / 'ost.yaml').write_text(yaml.safe_dump(calibration))
    known = np.ones(SIZE, bool)
    known[HIDDEN] = False
    save(folder / 'mask.png', known)


def run(*words):
    assert main([str(word) for word in words]) == 0


def fit(boards):
    """Fit a profile, and assert the noise in it; 20,000 pixels know it to 0.5 %."""
    out = boards.with_name('result')
    run('characterize', 'fit', boards, '--out', out, '--jobs', 1)
    (mode,) = load_profile(out / 'profile.yaml').modes
    np.testing.assert_allclose(mode.noise.sigma_z(Z, 0.3), sigma_z(Z), rtol=0.05)
    return out / 'profile.yaml'


def diagnose(campaign, profile):
    out = campaign.with_name('diagnosis')
    words = 'gap', 'diagnose', campaign, '--profile', profile, '--out', out, '--jobs', 1
    run(*words, *leaving(*KEPT))
    return dict(json.loads((out / 'diagnosis.json').read_text()))


def effects_of(table):
    return {row['name']: row['parameters'] for row in table['effects']}


def test_images_with_a_mask_and_a_rational_lens(tmp_path):
    """Assert nothing but whole millimetres is found with planes that a laser measured."""
    rng = np.random.default_rng(1)
    for kind, walls in (('boards', BOARDS), ('walls', WALLS)):
        (tmp_path / kind).mkdir()
        for i, place in enumerate(walls):
            images = tmp_path / 'images' / f'{kind}{i}'
            write_lens_and_mask(images)
            for number, image in enumerate(millimetres(wall(*place), 12, rng)):
                save(images / f'{number}.png', image)
            out = tmp_path / kind / f'w{i}.npz'
            run('convert', images, out, '--usecase', 'tof', '--rate', 15)
    profile = fit(tmp_path / 'boards')
    np.testing.assert_array_equal(load_profile(profile).intrinsics.distortion, LENS)
    planes = {
        'schema': 1,
        'planes': [{'name': 'wall', 'box': [10, 10, 60, 60]}],
        'recordings': {
            f'w{i}': {'wall': {'box': [10, 10, 60, 60], 'distance': f'{distance} +- 0.001'}}
            for i, (distance, _) in enumerate(WALLS)
        },
    }
    (tmp_path / 'planes.yaml').write_text(yaml.safe_dump(planes))
    run(
        *('gap', 'truth', tmp_path / 'walls', '--planes', tmp_path / 'planes.yaml'),
        *('--profile', profile, '--out', tmp_path / 'campaign', '--jobs', 1),
    )
    for i, place in enumerate(WALLS):
        found = load_recording(tmp_path / 'campaign' / f'w{i}.npz')
        known = found.extra['known']
        assert not known[HIDDEN].any()
        np.testing.assert_allclose(found.clean_depth[known], wall(*place)[known], atol=0.002)
    assert set(effects_of(diagnose(tmp_path / 'campaign', profile))) <= {'quantisation'}


def test_archives_of_an_sdk(tmp_path):
    """
    Assert an offset of 20 mm is found in single frames, beside correlated noise.

    The noise of the profile is independent between pixels. That of the camera went through a
    filter, which is named. That there is more noise before it can be missed.
    """
    rng = np.random.default_rng(2)
    write_lens_and_mask(tmp_path)
    for kind, walls, bias in (('boards', BOARDS, 0.0), ('walls', WALLS, 0.02)):
        (tmp_path / kind).mkdir()
        for i, place in enumerate(walls):
            counts = millimetres(wall(*place) + bias, 1, rng, blur=0.85)
            sdk = tmp_path / 'sdk.npz'
            np.savez(sdk, distance=counts[0], t=np.zeros(1), clean_depth=wall(*place))
            run(
                *('convert', sdk, tmp_path / kind / f'w{i}.npz', '--usecase', 'tof'),
                *('--key', 'depth=distance', '--key', 'stamp=t'),
                *('--calibration', tmp_path / 'ost.yaml', '--mask', tmp_path / 'mask.png'),
            )
    table = diagnose(tmp_path / 'walls', fit(tmp_path / 'boards'))
    effects = effects_of(table)
    assert effects.pop('offset')['bias'] == pytest.approx(0.02, rel=0.1)
    assert 'spatial_filter' in effects
    assert set(effects) <= {'spatial_filter', 'excess_noise', 'quantisation'}
    assert 'neighbour' not in {row['structure'] for row in table['unexplained']}

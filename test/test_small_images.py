"""Cameras of 8 x 8 pixels, and masks, through every command up to the diagnosis."""

import json
from pathlib import Path
import re

from bench.wall_campaigns import wall
from campaigns import leaving
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import load_effects, load_randomisation
from flexx2_sim_ros.effects.time_offset import TimeOffset
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.recording import load_recording, open_recording
from flexx2_sim_ros.recording.convert import convert
from flexx2_sim_ros.recording.corrections import Given
from flexx2_sim_ros.truth.observation import observe
import numpy as np
from PIL import Image
import pytest
from real_frames import DATA

K = np.array([[9.6, 0.0, 3.5], [0.0, 9.6, 3.5], [0.0, 0.0, 1.0]])
SIZE = 8, 8
FRAMES = 20
_PAGE = Path(__file__).parent.parent / 'docs' / 'benchmark.md'
# The sensor's profile: the first YAML on the page.
VL53L5CX = _PAGE.read_text(encoding='utf-8').split('```yaml\n')[1].split('```')[0]


def record(folder, walls, frames, bias):
    """Write an SDK's archives with noise of 2 mm + 2 mm/m^2 z^2, and convert them."""
    rng = np.random.default_rng(3)
    folder.mkdir()
    for i, (distance, angle) in enumerate(walls):
        clean = wall(distance, angle, K, SIZE)
        noise = (0.002 + 0.002 * clean**2) * rng.standard_normal((frames, 8, 8))
        sdk = folder.parent / 'sdk.npz'
        np.savez(
            sdk,
            distance_mm=np.rint(1000 * (clean + bias + noise)).astype(np.uint16),
            t=np.arange(frames) / 15,
            clean_depth=clean,
            K=K,
        )
        keys = ['--key', 'depth=distance_mm', '--key', 'stamp=t', '--usecase', 'tof8']
        assert main(['convert', str(sdk), str(folder / f'wall{i}.npz'), *keys]) == 0


def fit(folder):
    out = folder.with_name(f'{folder.name}_fit')
    assert main(['characterize', 'fit', str(folder), '--out', str(out), '--jobs', '1']) == 0
    return out / 'profile.yaml'


def diagnosis(folder, profile, *options):
    """Return the diagnosis of a folder, which is written beside it."""
    out = folder.with_name('out')
    words = ['gap', 'diagnose', folder, '--profile', profile, '--out', out, '--jobs', '1']
    assert main([*map(str, words), *options]) == 0
    return dict(json.loads((out / 'diagnosis.json').read_text()))


BOARDS = [(0.6, 5.0), (0.9, 40.0), (1.3, 10.0), (1.8, 45.0), (2.2, 20.0)]
WALLS = [(0.7, 10.0), (0.9, 30.0), (1.1, 0.0), (1.4, 40.0), (1.6, 20.0), (1.8, 5.0)]


def test_a_camera_of_64_pixels_is_measured_and_diagnosed(tmp_path):
    record(tmp_path / 'boards', BOARDS, FRAMES, 0.0)
    record(tmp_path / 'campaign', WALLS, 2 * FRAMES, 0.03)
    profile = fit(tmp_path / 'boards')
    kept = ('offset', 'intrinsics_error', 'quantisation', 'pose_error')
    table = diagnosis(tmp_path / 'campaign', profile, *leaving(*kept))
    effects = {row['name']: row['parameters'] for row in table['effects']}
    assert effects['offset']['bias'] == pytest.approx(0.03, rel=0.1)
    # The SDK's whole millimetres may be found, too.
    assert set(effects) <= {'offset', 'quantisation'}


def test_single_frames_of_64_pixels(tmp_path, capsys):
    """Assert a profile, and that so few pixels are too few for a diagnosis: no false alarm."""
    record(tmp_path / 'boards', BOARDS, 1, 0.0)
    record(tmp_path / 'campaign', WALLS, 1, 0.03)
    profile = fit(tmp_path / 'boards')
    capsys.readouterr()
    options = leaving('offset', 'quantisation', 'pose_error')
    assert not diagnosis(tmp_path / 'campaign', profile, *options)['effects']
    assert 'Too few depths of the recordings' in ' '.join(capsys.readouterr().err.split())


def write_flight(path, latency, seed, frames=100):
    """Write an archive of a sensor that flies to and fro before a panel; its images are late."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, 3)
    v, u = np.mgrid[:8, :8]
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]

    def seen(time):
        distance = 1.3 + 0.9 * np.cos(0.9 * time + phase[0])
        yaw, aside = 0.15 * np.sin(0.7 * time + phase[1]), 0.1 * np.sin(0.8 * time + phase[2])
        depth = (aside * np.sin(yaw) + distance * np.cos(yaw)) / (x * np.sin(yaw) + np.cos(yaw))
        on_panel = (np.abs(x * depth - aside) < 0.25) & (np.abs(y * depth) < 0.25)
        return np.where(on_panel, depth, np.nan)

    stamp = np.cumsum(rng.choice([1, 1, 1, 2], frames)) / 15
    real = np.array([seen(time - latency) for time in stamp])
    depth = real + (0.008 + 0.004 * real**2) * rng.standard_normal(real.shape)
    clean = np.where(np.isfinite(depth), [seen(time) for time in stamp], np.nan)
    received = stamp + rng.uniform(0.06, 0.08, frames)
    np.savez(path, depth=depth, clean_depth=clean, K=K, stamp=stamp, received=received)


def diagnosed(folder, latency):
    """Return the diagnosis of three flights."""
    profile = folder / 'profile.yaml'
    profile.write_text(VL53L5CX)
    (folder / 'flights').mkdir()
    for seed in range(3):
        write_flight(folder / 'sdk.npz', latency, seed)
        out = str(folder / 'flights' / f'{seed}.npz')
        given = ['--usecase', 'vl53l5cx', '--partial-truth']
        assert main(['convert', str(folder / 'sdk.npz'), out, *given]) == 0
    kept = ('time_offset', 'quantisation', 'temporal_filter', 'pose_error')
    return diagnosis(folder / 'flights', profile, *leaving(*kept))


def test_the_latency_of_a_sensor_of_64_pixels_is_found(tmp_path, capsys):
    """Assert it where only a few pixels have ground truth, the others are unknown."""
    latency = 0.1
    table = diagnosed(tmp_path, latency)
    assert all(row['truth']['unknown'] > 0.5 for row in table['recordings'])
    assert [row['name'] for row in table['effects']] == ['time_offset']
    assert table['effects'][0]['parameters']['latency'] == pytest.approx(latency, rel=0.2)
    # What is written is the age of the images in all its parts, for every path that reads effects.
    assert table['age']['latency'] == pytest.approx(latency, rel=0.2)
    assert table['age']['delay']['median'] == pytest.approx(0.07, abs=0.003)
    (late,) = load_effects(tmp_path / 'out' / 'effects.yaml')
    assert isinstance(late, TimeOffset)
    assert late.latency_ns == pytest.approx(1e9 * table['age']['latency'])
    assert late.delay_ns == pytest.approx(1e9 * table['age']['delay']['median'], abs=1)
    assert re.search('Images arrive (69|70|71) ms after their stamps', capsys.readouterr().err)
    words = ['gap', 'randomise', str(tmp_path / 'out'), '--out', str(tmp_path / 'r.yaml')]
    assert main(words) == 0
    drawn = [own[0] for own in load_randomisation(tmp_path / 'r.yaml').draw(50, 1)]
    assert np.mean([one.delay_ns for one in drawn]) == pytest.approx(0.07e9, rel=0.1)
    assert np.std([one.delay_ns for one in drawn]) > 0
    assert np.mean([one.latency_ns for one in drawn]) == pytest.approx(latency * 1e9, rel=0.3)


def test_what_is_unknown_stays_unknown(tmp_path):
    """Assert it of a recording with ground truth that gets a mask besides."""
    known, mask = np.ones((3, 8, 8), bool), np.ones((8, 8), bool)
    known[1, 2, :] = False
    mask[:, 5] = False
    clean = np.ones((8, 8), np.float32)
    clean[7, 7] = np.nan
    np.savez(tmp_path / 'in.npz', depth=np.ones((3, 8, 8)), K=K, clean_depth=clean, known=known)
    Image.fromarray(mask).save(tmp_path / 'mask.png')
    given = Given(mask=tmp_path / 'mask.png', partial_truth=True)
    convert(tmp_path / 'in.npz', tmp_path / 'out.npz', given=given)
    found = load_recording(tmp_path / 'out.npz').extra['known']
    np.testing.assert_array_equal(found, known & mask & np.isfinite(clean))


def test_partial_truth_needs_ground_truth(tmp_path):
    np.savez(tmp_path / 'in.npz', depth=np.ones((3, 8, 8)), K=K)
    with pytest.raises(InputError, match='must come with clean_depth'):
        convert(tmp_path / 'in.npz', tmp_path / 'out.npz', given=Given(partial_truth=True))


def test_recordings_of_a_real_sensor_of_64_pixels_are_read(tmp_path):
    source = DATA / 'vl53l5cx_flights.npz'
    if not source.is_file():
        pytest.skip(f'{source} is not there')
    out = tmp_path / 'out.npz'
    keys = [f'{ours}=A0_{ours}' for ours in ('depth', 'clean_depth', 'stamp')]
    options = [text for key in keys for text in ('--key', key)]
    assert main(['convert', str(source), str(out), *options, '--usecase', 'vl53l5cx']) == 0
    found = load_recording(out)
    with np.load(source, allow_pickle=False) as data:
        np.testing.assert_array_equal(found.depth, data['A0_depth'].astype(np.float32))
        np.testing.assert_array_equal(found.stamp, data['A0_stamp'])
    assert found.depth.shape[1:] == (8, 8)


def test_masked_pixels_get_no_ground_truth(tmp_path):
    """Assert this also for a lens of eight coefficients, whose rays are otherwise all there."""
    known = np.ones((8, 8), bool)
    known[:, :3] = False
    lens = np.array([0.5, 0.3, 0.0, 0.0, 0.02, 0.6, 0.4, 0.08])
    arrays = {
        'depth': np.stack([wall(1.0, 5, K, SIZE)] * 3).astype(np.float32),
        'K': K,
        'distortion': lens,
    }
    for name, extra in (('masked', {}), ('with truth', {'clean_depth': wall(1.0, 5, K, SIZE)})):
        path = tmp_path / f'{name}.npz'
        np.savez(path, **arrays, known=known, **extra)
        rays = observe(open_recording(path), None).still.rays
        seen = known if name == 'masked' else np.ones_like(known)
        np.testing.assert_array_equal(np.isfinite(rays).all(axis=-1), seen)
        camera = Intrinsics.from_matrix(K, 8, 8, lens)
        np.testing.assert_array_equal(rays[seen], np.moveaxis(pixel_rays(camera), 0, -1)[seen])

"""Six walls with a known error: what is found, how large it is said to be, and in which units."""

from dataclasses import replace

from campaigns import ALIKE, among, change, find_all, K, MODE, read_all, save, SHAPE, write_walls
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.gap import check as check_diagnosis
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.data.campaign import check, Found, read
import numpy as np
import pytest

USUAL, FEW = among(*ALIKE), among('offset', 'pose_error')
DISTANCES = (0.8, 1.1, 1.4, 1.8, 2.2, 2.8)


def test_an_offset_of_recordings_with_the_very_same_noise(tmp_path):
    """
    Assert that it alone is found, in millimetres: sigma_z is 1.8 to 11 mm on these walls.

    9,600 pixels of 10 frames know each wall's depth to 0.05 mm.
    """
    table = diagnose(write_walls(tmp_path, DISTANCES, same=True, offset={'bias': 0.01}), **USUAL)
    assert table['verdict'] == 'identified'
    (effect,) = table['effects']
    assert effect['name'] == 'offset'
    assert effect['parameters']['bias'] == pytest.approx(0.01, rel=0.05)
    assert table['gap']['shrink'] > 0.95
    assert table['gap']['wasserstein_mm']['shrink'] > 0.98
    assert not any(row['channel'] == 'repeat' for row in table['where'])
    (bias,) = (row for row in table['where'] if row['channel'] == 'bias')
    assert (bias['size'], bias['unit_size']) == (pytest.approx(10, rel=0.1), 'mm')
    notes = [note for row in table['recordings'] for note in row['notes']]
    assert sum('very same noise' in note for note in notes) == 6


def test_a_wall_where_the_range_ends_is_no_gap(tmp_path):
    """Assert that it does not matter which of its pixels have a depth: a pose decides that."""
    write_walls(tmp_path, DISTANCES)
    clean = np.full(SHAPE, 7.0, np.float32) + np.linspace(-0.01, 0.01, SHAPE[1], dtype=np.float32)
    stamp = np.arange(10) / 30
    for i in range(3):  # The pose is wrong by 6 mm.
        seen = Camera(MODE, seed=10 + i).capture(clean + np.float32(0.006), K, stamp).depth
        save(tmp_path / f'far{i}.npz', seen, clean, K)
    assert diagnose(tmp_path, **USUAL)['verdict'] == 'none'


def test_a_bias_of_some_recordings_is_reported_for_each(tmp_path):
    write_walls(tmp_path, DISTANCES)
    wrong = {2: 0.018, 3: -0.015, 5: 0.030}
    for i, bias in wrong.items():
        change(tmp_path / f'wall{i}.npz', depth=lambda one, b=bias: one['depth'] + np.float32(b))
    table = diagnose(tmp_path, pose_prior=(0.0001, 0.01), **among('offset'))
    rows = [row for row in table['where'] if row['channel'] == 'bias']
    assert rows[0]['covariate'] in ('distance', 'fine_distance')
    assert len(rows) >= 2
    for row in rows:
        # A wall that is farther is a camera that stood back: what is left when that is taken off.
        left = [
            1000 * (wrong.get(i, 0.0) + table['recordings'][i]['pose'][2])
            for i, distance in enumerate(DISTANCES)
            if row['low'] - 1e-6 < distance < row['high'] + 1e-6
        ]
        assert row['size'] == pytest.approx(np.mean(left), rel=0.1, abs=0.3)


def test_invalid_pixels_are_reported_as_a_fraction(tmp_path):
    """Assert it of what is really lost, wall by wall, over amplitude and over distance."""
    write_walls(tmp_path, DISTANCES, low_signal_dropout={'half': 0.2})
    lost = {}
    for i, distance in enumerate(DISTANCES):
        with np.load(tmp_path / f'wall{i}.npz') as archive:
            lost[distance] = float(np.isnan(archive['depth']).mean())
    assert lost[2.8] > 0.5
    table = diagnose(tmp_path, **among('low_signal_dropout', 'saturation', 'pose_error'))
    rows = [row for row in table['where'] if row['channel'] == 'invalid']
    assert rows[0]['covariate'] == 'amplitude'  # the effect that is named depends on it
    for row in rows:
        assert row['unit_size'] == 'fraction'
        # The walls have a reflectivity of 1.
        along = {'distance': lambda z: z, 'amplitude': lambda z: 1 / z**2}[row['covariate']]
        inside = [
            share
            for distance, share in lost.items()
            if (row['low'] or 0) < along(distance) < (row['high'] or 99)
        ]
        assert row['size'] == pytest.approx(np.mean(inside), rel=0.1, abs=0.01)


def rewrite(folder, **changes):
    """Change all recordings; see `change`."""
    for path in folder.glob('*.npz'):
        change(path, **changes)


def test_depth_outside_the_range_of_the_profile_is_said(tmp_path):
    far = write_walls(tmp_path, DISTANCES) / 'wall5.npz'
    camera = flexx2()
    mode = replace(camera.mode(MODE), range_max=2.81)
    # The noise of a wall at 2.8 m takes a part of its depths beyond 2.81 m.
    for profile, wanted in ((camera, []), (replace(camera, modes=(mode,)), ['0.1 to 2.81 m'])):
        found = check(far, profile)
        assert isinstance(found, Found)
        said = [note for note in read(found, profile).notes if 'is outside' in note]
        assert len(said) == len(wanted)
        assert all(text in note for text, note in zip(wanted, said, strict=True))


def test_scaled_amplitudes_and_missing_stamps_are_reported(tmp_path):
    """Assert that 0 to 1 is taken for that, and what can be no reflectivity is not used."""
    write_walls(tmp_path, DISTANCES)

    def noted(words):
        notes = [{*one.notes, *read(one, None).notes} for one in find_all(tmp_path)]
        return sum(words in note for of_one in notes for note in of_one)

    rewrite(tmp_path, amplitude=lambda one: np.float32(0.5) / one['clean_depth'] ** 2, stamp=None)
    assert noted('taken for 0 to 1') == 6
    assert noted('stamp: not in the file: taken for 30 Hz') == 6
    rewrite(tmp_path, amplitude=np.full(SHAPE, 1e-6))
    assert noted('amplitude: not used') == 6


def test_all_recordings_of_a_campaign_have_one_scale_of_amplitude(tmp_path):
    """Assert that a dark scene, whose amplitudes are all below 1, is on the scale of the rest."""
    paths = sorted(write_walls(tmp_path, DISTANCES).iterdir())
    for path, gray in zip(paths, (0.8, 9, 9, 9, 9, 200), strict=True):
        change(path, amplitude=np.full(SHAPE, gray, np.float32))
    notes = [note for one in read_all(tmp_path) for note in one.notes if 'amplitude' in note]
    assert len(notes) == 6
    assert all('0 to 255' in note for note in notes)


def test_a_check_takes_the_scale_of_amplitude_from_its_diagnosis(tmp_path):
    """Assert that fresh recordings, all darker than 1, are on the scale of the diagnosis."""
    seen = write_walls(tmp_path / 'seen', DISTANCES, offset={'bias': 0.01})
    rewrite(seen, amplitude=lambda one: np.float32(50) / one['clean_depth'] ** 2)
    settings = diagnose(seen, out=tmp_path / 'out', **FEW)['settings']
    assert settings['full_scale'] == 255
    fresh = write_walls(tmp_path / 'fresh', DISTANCES, same=True, offset={'bias': 0.01})
    rewrite(fresh, amplitude=lambda one: np.float32(0.5) / one['clean_depth'] ** 2)
    table = check_diagnosis(tmp_path / 'out', fresh)
    notes = [note for row in table['recordings'] for note in row['notes'] if 'amplitude' in note]
    assert len(notes) == 6
    assert all('taken for 0 to 255' in note for note in notes)


def test_surfaces_with_too_much_noise_are_too_little_to_look_at(tmp_path):
    # At 6.5 m, sigma_z of the Flexx2 no longer says how depth errors are distributed.
    write_walls(tmp_path, (6.5,) * 3, frames=3)
    table = diagnose(tmp_path, out=tmp_path / 'out', **FEW)
    assert table['verdict'] == 'too_little'
    assert all('to compare, got 0' in ' '.join(row['notes']) for row in table['recordings'])
    # Large errors were measured: the page must not say that nothing differs.
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert 'Too few depths to compare' in page
    assert 'No region differs' not in page

"""Recordings of other cameras: with masks, and named in other ways."""

from dataclasses import replace

from boards import board
from flexx2_sim_ros.camera import flexx2, Intrinsics
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.characterize.histogram import noise_histogram
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.profiles.files import read_profile
from flexx2_sim_ros.profiles.sensor import DEFAULT_SENSOR
from flexx2_sim_ros.profiles.valid_mask import mask_of
import numpy as np
import pytest

SIZE = (60, 80)
PLACES = ((0.7, 0), (0.7, 40), (1.0, 20), (1.5, 0), (1.5, 50), (2.0, 30), (2.5, 0), (2.5, 45))
NOISE = flexx2().mode('Mode_9_30fps').noise


def content(distance, angle):
    """Make a recording of a board that fills the image."""
    target = board(distance, angle, size=SIZE)
    sigma = NOISE.sigma_z(target.depth, target.incidence)
    noise = np.random.default_rng(round(1000 * distance + angle)).standard_normal((12, *SIZE))
    return {
        'depth': (target.depth + sigma * noise).astype(np.float32),
        'K': target.K,
        'stamp': np.arange(12) / 30,
        'usecase': 'Mode_9_30fps',
    }


@pytest.mark.parametrize('kind', ['known', 'known in each frame', 'profile'])
def test_masked_pixels_are_neither_invalid_nor_noise(tmp_path, kind):
    """
    Assert the share of invalid pixels among those that the mask leaves in, and their histogram.

    4000 pixels of 12 frames know a share of 3 % to 0.08 %.
    """
    generator = np.random.default_rng(5)
    left_in = generator.uniform(size=SIZE) > 0.15
    masked = np.broadcast_to(~left_in, (12, *SIZE))
    known = {} if kind == 'profile' else {'known': left_in}
    if kind == 'known in each frame':
        known['known'] = np.broadcast_to(left_in, (12, *SIZE)).copy()
        known['known'][::3] = True
        masked = ~known['known']
    profile = flexx2()
    if kind == 'profile':
        camera = Intrinsics.from_matrix(content(1.0, 0)['K'], *SIZE[::-1])
        sensor = replace(DEFAULT_SENSOR, valid_mask=mask_of(left_in, camera))
        modes = tuple(replace(mode, sensor=sensor) for mode in profile.modes)
        profile = replace(profile, modes=modes)
    for distance, angle in PLACES:
        made = content(distance, angle)
        depth = made['depth']
        depth[generator.uniform(size=depth.shape) < 0.03] = np.nan
        depth[masked] += 0.01  # The noise is some 4 mm.
        depth[masked & (generator.uniform(size=depth.shape) < 0.5)] = np.nan
        name = f'Mode_9_30fps_{distance:.2f}m_{angle}deg.npz'
        np.savez(tmp_path / name, **made | known, amplitude=np.full(depth.shape, 100.0))
    result = characterize(tmp_path, profile=profile)
    for m in result.modes[0].measurements:
        assert m.pixels.invalid == pytest.approx(0.03, abs=0.006)
        share = m.amplitude.invalid.sum() / m.amplitude.pixels.sum()
        assert share == pytest.approx(0.03, abs=0.006)
    histogram = noise_histogram(result)
    middles = (histogram.edges[1:] + histogram.edges[:-1]) / 2
    # The mean of 3000 values is known to 0.02 sigma.
    assert abs(np.average(middles, weights=histogram.counts)) < 0.15 * histogram.sigma


@pytest.mark.parametrize(
    ('spellings', 'name'),
    [(['MODE_9_30FPS', 'Mode_9_30fps'], 'Mode_9_30fps'), (['TOF', 'tof', 'ToF'], 'tof')],
)
def test_a_mode_is_the_same_in_upper_and_lower_case(tmp_path, spellings, name):
    for number, (distance, angle) in enumerate(PLACES):
        spelling = spellings[number % len(spellings)]
        np.savez(tmp_path / f'{number}.npz', **content(distance, angle) | {'usecase': spelling})
    assert main(['characterize', 'fit', str(tmp_path), '--jobs', '1']) == 0
    written = read_profile(tmp_path / 'characterization' / 'profile.yaml')
    assert written.profile.names == [name]
    assert written.standard_errors[name]['a'] is not None
    assert written.measured[name]['recordings'] == len(PLACES)
    page = (tmp_path / 'characterization' / 'report.html').read_text(encoding='utf-8')
    assert ('class="paper"' in page) == (name == 'Mode_9_30fps')


@pytest.mark.parametrize('stamps', ['none', 'all the same'])
def test_a_rate_that_stamps_do_not_tell_is_said_to_be_assumed(tmp_path, stamps):
    for number, (distance, angle) in enumerate(PLACES):
        made = content(distance, angle) | {'usecase': 'tof', 'stamp': np.zeros(12)}
        if stamps == 'none':
            del made['stamp']
        np.savez(tmp_path / f'{number}.npz', **made)
    written = to_profile(characterize(tmp_path))
    assert written.profile.mode('tof').rate_hz == 30.0
    said = [note for note in written.provenance['notes'] if 'rate_hz' in note]
    assert said == [
        'tof: rate_hz: unknown, needs several frames with stamps that rise; assumed 30'
    ]


def test_boards_at_one_distance_give_a_range_that_noise_does_not_leave(tmp_path):
    for number in range(3):
        np.savez(tmp_path / f'{number}.npz', **content(1.0, 0) | {'usecase': 'tof'})
    mode = to_profile(characterize(tmp_path)).profile.mode('tof')
    assert mode.range_min == pytest.approx(0.9, abs=0.01)
    assert mode.range_max == pytest.approx(1.1, abs=0.01)

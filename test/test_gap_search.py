"""What is free inside a camera is found from its recordings, before anything is simulated."""

from bench.gap_campaigns import write_campaign
from bench.wall_campaigns import wall
from boards import K
from campaigns import among, change, read_all
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.calibration.search import SEARCH
from flexx2_sim_ros.gap.data.clues import Clues, clues_of, light_edges
from flexx2_sim_ros.gap.features.catalogue import catalogue
from flexx2_sim_ros.gap.features.search import of_registration, search, SEARCHES
import numpy as np
import pytest
from study.blind import BlindCamera, Case, Internals, SceneKey, SceneSet

MODE = 'Mode_9_30fps'
KEY = SceneKey(MODE, 31, 2.0, 80, 62, 8, 12)
SCENES = SceneSet(KEY)
LIGHT = 2, len(light_edges()) - 1, len(SEARCH.incidences) - 1  # shape of `Clues.light`


def found_in(folder, effects, inside):
    """Record a blind camera with wrong poses and search its recordings."""
    BlindCamera(Case(KEY, effects, 31, internals=Internals(**inside)), SCENES).record(folder)
    return searched(folder)


def searched(folder):
    """Search recordings; return what is found and the clues of each."""
    clues = [clues_of(one) for one in read_all(folder)]
    return dict(search(clues, SCENES.optics.mode)), clues


@pytest.mark.parametrize(
    ('effect', 'inside', 'clue', 'wanted', 'within'),
    [
        ('wiggling', {'wave_m': 0.35}, 'wave', 0.35, 0.014),
        ('wiggling', {'wave_m': 1.6}, 'wave', 1.6, 0.064),
        ('range_wrap', {'mhz': 60.24}, 'fold', 149.896 / 60.24, 0.025),
        ('range_wrap', {'mhz': 31.0}, 'fold', 149.896 / 31.0, 0.05),
        ('time_offset', {'latency_s': 0.025}, 'latency', 0.025, 0.015),
        ('time_offset', {'latency_s': 0.16}, 'latency', 0.16, 0.015),
        # In this mode the camera drops pixels below 0.015 / m^2.
        ('low_signal_dropout', {'light_scale': 8.0}, 'darkness', 8 * 0.015, 0.06),
    ],
)
def test_what_is_free_inside_a_camera_is_found_beside_wrong_poses(
    effect, inside, clue, wanted, within, tmp_path
):
    found, _ = found_in(tmp_path, {effect: 1.0}, inside)
    assert set(found) == {clue}
    assert found[clue][0] == pytest.approx(wanted, abs=within)


@pytest.mark.parametrize(
    ('effects', 'unseen'),
    [
        ({}, set(SEARCHES)),
        ({'pose_error': 2.0}, {'latency', 'stretch', 'constant'}),
        ({'offset': 2.0}, {'stretch'}),
        ({'depth_scale': 2.0}, {'constant'}),
        ({'intrinsics_error': 2.0}, {'stretch', 'constant'}),
    ],
)
def test_other_causes_are_not_taken_for_it(effects, unseen, tmp_path):
    found, clues = found_in(tmp_path, effects, {})
    assert not unseen & set(found)
    # Two recordings agree by chance.
    for two in zip(clues[::2], clues[1::2], strict=True):
        assert not {'stretch', 'constant'} & set(search(two, SCENES.optics.mode))


def test_a_filter_over_frames_is_not_taken_for_a_latency(tmp_path):
    found, clues = found_in(tmp_path, {'temporal_filter': 1.0}, {})
    assert 'latency' not in found
    # A weight of 0.4 for the frame before is 0.4 / 0.6 frames; at 30 frames a second 22 ms.
    lags = [one.lag for one in clues if np.isfinite(one.lag)]
    assert len(lags) == 5  # the scenes that stand still
    assert np.median(lags) == pytest.approx(0.022, abs=0.004)


@pytest.mark.parametrize('strength', [0.5, 2.5])
def test_a_depth_scale_is_found_and_named(strength, tmp_path):
    """Of 1 % and 5 %: a pose takes up the one, and the other is far beyond what poses are."""
    found, _ = found_in(tmp_path, {'depth_scale': strength}, {})
    assert abs(found['stretch'][0]) == pytest.approx(0.02 * strength, rel=0.15)
    rivals = 'offset', 'wiggling', 'amplitude_bias', 'intrinsics_error', 'pose_error'
    first, *others = diagnose(tmp_path, **among('depth_scale', *rivals))['effects']
    assert first['name'] == 'depth_scale'
    assert first['parameters']['fraction'] == pytest.approx(found['stretch'][0], rel=0.15)
    assert not others


@pytest.mark.parametrize(('bias', 'seed'), [(0.03, 14), (-0.05, 13), (0.15, 14)])
def test_an_offset_that_poses_could_not_take_up_is_named(bias, seed, tmp_path):
    """A depth scale was named for it, since features are not linear up to there."""
    few = {'recordings': 6, 'frames': 6, 'scale': 0.25, 'moving': 0}
    write_campaign(tmp_path, effects={'offset': {'bias': bias}}, seed=seed, **few)
    rivals = 'offset', 'depth_scale', 'wiggling', 'multipath', 'intrinsics_error', 'pose_error'
    table = diagnose(tmp_path, **among('warm_up_drift', *rivals))
    assert [row['name'] for row in table['effects']] == ['offset']
    assert table['effects'][0]['parameters']['bias'] == pytest.approx(bias, rel=0.2)
    assert table['gap']['shrink'] > 0.8


@pytest.mark.parametrize(('bias', 'fraction', 'seed'), [(0.03, 0.02, 24), (0.02, 0.01, 26)])
def test_a_constant_and_a_scale_are_told_apart(bias, fraction, seed, tmp_path):
    """The one was named for both: it explained most, and poses took up the rest."""
    effects = {'offset': {'bias': bias}, 'depth_scale': {'fraction': fraction}}
    small = {'recordings': 6, 'frames': 6, 'scale': 0.35, 'moving': 0}
    write_campaign(tmp_path, effects=effects, seed=seed, **small)
    rivals = 'wiggling', 'multipath', 'intrinsics_error', 'amplitude_bias'
    table = diagnose(tmp_path, **among(*effects, *rivals))
    named = {row['name']: row['parameters'] for row in table['effects']}
    assert named['offset']['bias'] == pytest.approx(bias, rel=0.2)
    assert named['depth_scale']['fraction'] == pytest.approx(fraction, rel=0.2)
    assert table['gap']['shrink'] > 0.8


@pytest.mark.parametrize(
    ('effect', 'found'),
    [
        ({'depth_scale': {'fraction': 0.03}}, {'stretch': 0.03}),
        ({'offset': {'bias': 0.06}}, {'constant': 0.06}),
    ],
)
def test_a_large_bias_is_found_at_bare_walls(effect, found, tmp_path):
    """A pose could take it up, but would be wrong by more than poses are, as distances say."""
    for i, distance in enumerate((0.8, 1.2, 1.8, 2.5, 3.2)):
        clean = wall(distance, 10.0 * i, K, (172, 224))
        seen = Camera(MODE, effects=effect, seed=i).capture(clean, K, np.arange(4) / 30)
        content = {'clean_depth': clean, 'depth': seen.depth, 'K': K, 'usecase': MODE}
        np.savez(tmp_path / f'{i}.npz', **content, stamp=np.arange(4) / 30)
    biases = {k: v[0] for k, v in searched(tmp_path)[0].items() if k in ('stretch', 'constant')}
    assert biases == pytest.approx(found, rel=0.1)


def test_the_light_that_saturates_a_camera_head_on_is_found(tmp_path):
    found, _ = found_in(tmp_path, {'saturation': 1.0}, {})
    half, _, gloss, lobe = found['glare']
    # The camera adds twice the light where a glossy surface faces it, in a lobe of 5.7 degrees,
    # and is full at half of 5.2 / m^2.
    assert half == pytest.approx(2.6, rel=0.5)
    assert gloss in (1.0, 2.0, 4.0)
    assert lobe in (4.0, 6.0, 9.0)


def test_what_is_found_becomes_variants_of_effects():
    plain = {candidate.label for candidate in catalogue()[1]}
    found = {'wave': (0.8,), 'fold': (2.49,), 'latency': (0.115,), 'darkness': (0.002, 3.0)}
    found |= {'glare': (6.0, 12.0, 2.0, 6.0), 'stretch': (0.05,), 'constant': (0.03,)}
    columns, candidates = catalogue((), True, found)
    new = [one for one in candidates if one.label not in plain]
    assert {one.effect for one in new} == {
        'wiggling',
        'range_wrap',
        'time_offset',
        'low_signal_dropout',
        'saturation',
        'depth_scale',
        'offset',
    }
    names = {column.name for column in columns}
    assert all(names >= set(one.columns) for one in new)
    for one in new:
        table = one.build(tuple(term.nodes[0][0] for term in one.terms))
        registry()[one.effect].from_mapping(table)


def test_every_search_that_an_effect_declares_exists():
    declared = {kind.searched.internal for kind in registry().values() if kind.searched}
    assert declared == set(SEARCHES)


def test_recordings_of_nothing_find_nothing():
    empty = Clues(
        error=np.zeros(0),
        sigma=np.zeros(0),
        own=np.zeros((0, 9)),
        length=np.zeros(0),
        distance=np.zeros(0),
        light=np.zeros(LIGHT),
        folds=np.zeros((2, 0)),
        beyond=0,
        looked=0,
        late=np.zeros(0),
        lag=np.nan,
    )
    assert search([empty, empty], SCENES.optics.mode) == {}
    assert of_registration({}) == ((), 0.0, (0.0, 0.0))


def test_few_frames_are_not_taken_for_a_latency(tmp_path):
    """Assert it where a long latency leaves three frames of eight: others are not compared."""
    for seed in (41, 42):
        folder = tmp_path / str(seed)
        write_campaign(folder, seed=seed, scale=0.5, recordings=1, frames=8, moving=1)
        assert 'latency' not in searched(folder)[0]


def test_depth_without_noise_is_not_taken_for_a_latency(tmp_path):
    write_campaign(tmp_path, seed=41, scale=0.3, recordings=1, frames=8, moving=1)
    (path,) = tmp_path.glob('*.npz')
    change(path, depth=lambda one: one['clean_depth'])
    assert 'latency' not in searched(tmp_path)[0]


def test_a_recording_with_few_depths_says_nothing_about_a_latency(tmp_path):
    write_campaign(tmp_path, seed=41, scale=0.3, recordings=1, frames=8, moving=1)
    (path,) = tmp_path.glob('*.npz')

    def few(one):
        row = np.arange(one['depth'].shape[1])
        return np.where(row[:, None] < 3, one['depth'], np.nan)

    change(path, depth=few)
    _, (clues,) = searched(tmp_path)
    assert len(clues.late) > 0
    assert np.isnan(clues.late).all()

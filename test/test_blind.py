"""
The blind camera: the paper's noise without effects, its recordings, and what it imports.

All draws are seeded, so a test that passes goes on passing.
"""

import ast
from pathlib import Path

from blind_looks import BOARD, CLOSE, CORNER, FAR, FORWARD, Look, MODES, plain, scenes
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
import numpy as np
import pytest
from study.blind import BlindCamera, Case, CATALOGUE, NOVEL, SceneKey, SceneSet
from study.blind.rooms import KINDS

ROOT = Path(__file__).resolve().parents[1]
NAMES = {
    'offset', 'wiggling', 'warm_up_drift', 'amplitude_bias', 'fixed_pattern', 'flying_pixels',
    'multipath', 'stray_light', 'range_wrap', 'low_signal_dropout', 'random_dropout',
    'grazing_dropout', 'saturation', 'temporal_filter', 'spatial_filter', 'depth_scale',
    'excess_noise', 'ambient_light', 'heavy_tails', 'lateral_noise', 'quantisation',
    'motion_artefact', 'time_offset', 'pose_error', 'intrinsics_error',
}  # fmt: skip


@pytest.mark.parametrize('usecase', MODES)
def test_without_effects_the_blind_camera_has_the_papers_noise(usecase):
    here = scenes(usecase)
    base = Camera(usecase, seed=8)
    for recording in (BOARD, FORWARD, CLOSE, FAR):
        seen = plain(recording, usecase)
        clean, _ = here.clean(recording)
        wanted = base.capture(clean, here.optics.intrinsics.matrix, 7 + here.times()).depth
        good = seen.flat & np.isfinite(seen.depth) & np.isfinite(wanted)
        assert good.sum() > 5_000
        ours, theirs = (
            np.clip(((depth - seen.clean) / np.maximum(seen.sigma, 1e-9))[good], -6, 6)
            for depth in (seen.depth, wanted)
        )
        # 20,000 samples fix the ratio to 0.7 %, 5,000 to 1.4 % and the mean to 2 % of sigma.
        assert ours.std() / theirs.std() == pytest.approx(
            1, abs=0.05 if good.sum() < 20_000 else 0.025
        )
        assert abs(ours.mean() - theirs.mean()) < 0.07
        bins = np.linspace(-4, 4, 33)
        p, q = ((np.histogram(part, bins)[0] + 1) / len(part) for part in (ours, theirs))
        assert (p * np.log(p / q)).sum() < 0.01
        assert np.isnan(seen.depth).mean() == pytest.approx(np.isnan(wanted).mean(), abs=0.005)


@pytest.mark.parametrize('usecase', MODES)
def test_edges_move_with_the_papers_sigma_x(usecase):
    here, seen = scenes(usecase), plain(CLOSE, usecase)
    clean, _ = here.clean(CLOSE)
    wanted = (
        Camera(usecase, seed=8)
        .capture(clean, here.optics.intrinsics.matrix, 7 + here.times())
        .depth
    )
    gross = [
        (np.abs((depth - seen.clean) / np.maximum(seen.sigma, 1e-9)) > 8)[seen.edge].mean()
        for depth in (seen.depth, wanted)
    ]
    # Some 600 edge rows and columns in the frames: their mean displacement is known to 3 %.
    assert gross[0] == pytest.approx(gross[1], rel=0.15)
    assert gross[1] > 0.02


def test_catalogue_is_complete_and_novel_effects_are_not_in_it():
    assert set(CATALOGUE) == NAMES
    assert len(NOVEL) >= 8
    assert not set(NOVEL) & NAMES
    with pytest.raises(InputError, match='offset'):
        BlindCamera(Case(SceneKey(MODES[0], 1, width=16, height=12), {'no_such': 1.0}))


@pytest.mark.parametrize('name', sorted(NOVEL))
def test_novel_effects_change_something(name):
    changed = [
        np.nanmean(
            np.abs(
                np.nan_to_num(Look({name: 1.0}, recording).residual)
                - np.nan_to_num(plain(recording).residual)
            )
            > 1
        )
        for recording in (FORWARD, CORNER)
    ]
    assert max(changed) > 0.005


def test_a_campaign_is_made_of_recordings(tmp_path):
    here = scenes(MODES[0], 2.0)
    camera = BlindCamera(Case(here.key, {'offset': 1.0}, 4), here)
    camera.record(tmp_path)
    assert len(list(tmp_path.iterdir())) == len(KINDS)
    for i, kind in enumerate(KINDS):
        recording = load_recording(tmp_path / f'{i}.npz')
        assert recording.usecase == MODES[0]
        assert recording.depth.shape == (8, 86, 112)
        assert recording.clean_depth.ndim == (
            3 if kind in ('forward', 'sideways', 'turning') else 2
        )
        assert recording.reflectivity is not None
        assert recording.extra['uptime'].shape == (8,)
        assert {'effects', 'seed', 'strength'}.isdisjoint(recording.extra)


def test_nuisances_are_always_on():
    here = scenes(MODES[0], 2.0)
    assert here.twists[:, 3:].std() == pytest.approx(2e-3, rel=0.5)
    assert np.degrees(here.twists[:, :3].std()) == pytest.approx(0.125, rel=0.5)
    cameras = [BlindCamera(Case(here.key, {}, seed), here) for seed in range(60)]
    # Sixty draws fix a standard deviation to 9 %.
    assert np.std([np.log(camera.sigma_factor) for camera in cameras]) == pytest.approx(
        0.05, rel=0.5
    )
    known, (_, true) = cameras[0].known_reflectivity(BOARD), here.clean(BOARD)
    assert 0.03 < np.std(np.log(known / true)) < 0.5
    levels = [scenes(MODES[0], pose).twists for pose in (0.0, 2.0)]
    assert not levels[0].any()
    assert levels[1].any()


def test_the_same_seed_gives_the_same_frames(tmp_path):
    key = SceneKey(MODES[1], 9, width=56, height=43, recordings=2, frames=2)
    case = Case(key, {'wiggling': 1.0, 'heavy_tails': 1.0}, 6)
    one, two, cached = (
        BlindCamera(case, SceneSet(key, cache)) for cache in (None, tmp_path, tmp_path)
    )
    for recording in range(2):
        frames = [
            np.stack([frame.depth for frame in camera.frames(recording)])
            for camera in (one, two, cached)
        ]
        np.testing.assert_array_equal(frames[0], frames[1])
        np.testing.assert_array_equal(frames[0], frames[2])
    assert list(tmp_path.glob('true-*.npz'))


def imports_of(package):
    """Return the modules that a package's files import, anywhere in them."""
    found = set()
    for path in (ROOT / package).rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found |= {node.module or ''} | {
                    f'{node.module}.{alias.name}' for alias in node.names
                }
    return found


@pytest.mark.parametrize(
    ('package', 'forbidden'),
    [
        ('study/blind', ('flexx2_sim_ros.gap', 'flexx2_sim_ros.effects', 'study.benchmark')),
        ('flexx2_sim_ros/gap', ('study',)),
        ('flexx2_sim_ros/effects', ('study', 'flexx2_sim_ros.gap')),
    ],
)
def test_the_blind_camera_and_the_diagnosis_import_nothing_of_each_other(package, forbidden):
    met = {
        name
        for name in imports_of(package)
        if any(name == root or name.startswith(f'{root}.') for root in forbidden)
    }
    assert not met


def test_the_blind_camera_shares_only_geometry_and_the_papers_sigma():
    ours = {name for name in imports_of('study/blind') if name.startswith('flexx2_sim_ros.')}
    allowed = (
        'flexx2_sim_ros.profiles.modes',
        'flexx2_sim_ros.profiles.intrinsics',
        'flexx2_sim_ros.physics.surface',
        'flexx2_sim_ros.physics.compiled',  # keeps compiled loops on disk
        'flexx2_sim_ros.errors',
        'flexx2_sim_ros.atomic',
        'flexx2_sim_ros.recording',
    )
    assert {name for name in ours if not name.startswith(allowed)} == set()

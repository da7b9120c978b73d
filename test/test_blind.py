"""
The blind camera: the paper's noise, its recordings, its effects, and what it imports.

All draws are seeded, so a test that passes goes on passing.
"""

import ast
from pathlib import Path

from blind_looks import (
    BOARD,
    CLOSE,
    CORNER,
    correlation,
    FAR,
    FORWARD,
    Look,
    MODES,
    plain,
    scenes,
    STAIRS,
    STILL,
)
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
import numpy as np
import pytest
from study.blind import BlindCamera, Case, CATALOGUE, Internals, NOVEL, SceneKey, SceneSet
from study.blind.rooms import KINDS

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize('usecase', MODES)
def test_without_effects_the_blind_camera_has_the_papers_noise_and_edges(usecase):
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
        if recording != CLOSE:
            continue
        gross = [
            (np.abs((depth - seen.clean) / np.maximum(seen.sigma, 1e-9)) > 8)[seen.edge].mean()
            for depth in (seen.depth, wanted)
        ]
        # Some 600 edge rows and columns in the frames: their mean displacement is known to 3 %.
        assert gross[0] == pytest.approx(gross[1], rel=0.15)
        assert gross[1] > 0.02


def test_catalogue_is_complete_and_novel_effects_are_not_in_it():
    assert set(CATALOGUE) == set(registry())
    assert len(NOVEL) >= 8
    assert not set(NOVEL) & set(CATALOGUE)
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


def test_the_blind_camera_shares_only_geometry_and_the_papers_sigma():
    ours = set()
    for path in (ROOT / 'study' / 'blind').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                ours |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                ours |= {f'{node.module}.{alias.name}' for alias in node.names}
    allowed = (
        'study.blind',
        'flexx2_sim_ros.profiles.modes',
        'flexx2_sim_ros.profiles.intrinsics',
        'flexx2_sim_ros.physics.surface',
        'flexx2_sim_ros.physics.compiled',  # keeps compiled loops on disk
        'flexx2_sim_ros.errors',
        'flexx2_sim_ros.atomic',
        'flexx2_sim_ros.recording',
    )
    own = {name for name in ours if name.startswith(('flexx2_sim_ros', 'study'))}
    assert {name for name in own if not name.startswith(allowed)} == set()


# Each effect shows as it should.


def test_offset_and_drift_add_the_same_distance_everywhere():
    offset = Look({'offset': 1.0}, CLOSE)
    # 10 mm along the ray, a little less along the axis.
    assert 8e-3 < abs(offset.bias()) < 10.5e-3
    assert offset.spread() == pytest.approx(1, abs=0.05)
    drifts = [abs(Look({'warm_up_drift': 1.0}, recording).bias()) for recording in STILL]
    cold = np.argsort(scenes(MODES[0]).uptimes[list(STILL)])
    assert drifts[cold[0]] > 2 * drifts[cold[-1]]
    assert max(drifts) < 16e-3


def test_wiggling_goes_with_distance():
    seen = Look({'wiggling': 1.0}, CORNER)
    error = np.nanmean(seen.error, axis=0)[seen.flat[0]]
    assert 2e-3 < np.sqrt(np.nanmean(error**2)) < 12e-3
    path = (seen.clean[0] * scenes(MODES[0]).optics.ray_length)[seen.flat[0]]
    groups = np.digitize(path, np.quantile(path, np.linspace(0, 1, 30)[1:-1]))
    means = np.array([np.nanmean(error[groups == k]) for k in range(29)])
    # What is left after its mean at each range is the noise of eight frames.
    assert np.nanstd(error - means[groups]) < 0.5 * np.std(means)


def test_amplitude_bias_moves_dark_surfaces_away():
    seen = Look({'amplitude_bias': 1.0}, BOARD)
    log = np.log(np.maximum(seen.amplitude, 1e-6))
    low, high = np.quantile(log[seen.flat], [0.1, 0.9])
    assert 1e-3 < seen.bias(log < low) - seen.bias(log > high) < 15e-3


def test_fixed_pattern_repeats():
    one, other = (
        np.nanmean(Look({'fixed_pattern': 2.0}, recording).error, axis=0)
        for recording in (CORNER, CLOSE)
    )
    flat = plain(CORNER).flat[0] & plain(CLOSE).flat[0]
    assert correlation(one, other, flat) > 0.7
    assert 2e-3 < np.nanstd(one[flat]) < 6e-3


def test_flying_pixels_lie_between_the_surfaces():
    def between(look):
        # Farther than the board by a decimetre, nearer than the wall by one.
        near, far = (np.nanquantile(look.clean, share) for share in (0.05, 0.95))
        return float(((look.depth > near + 0.12) & (look.depth < far - 0.12))[look.edge].mean())

    near, far = np.nanquantile(plain(CLOSE).clean, [0.05, 0.95])
    assert far - near > 0.3
    assert between(Look({'flying_pixels': 1.0}, CLOSE)) > between(plain(CLOSE)) + 0.01


def test_multipath_moves_concave_corners_away():
    corner, board = Look({'multipath': 1.0}, CORNER), Look({'multipath': 1.0}, CLOSE)
    assert corner.bias() > 4e-3
    assert corner.bias() > 3 * abs(board.bias())


def test_stray_light_moves_dark_surfaces_to_bright_ones():
    seen = Look({'stray_light': 2.0}, CLOSE)
    shift = np.nanmedian((seen.error - plain(CLOSE).error)[0], axis=None)
    behind = seen.clean > np.nanquantile(seen.clean, 0.9) - 0.05
    assert seen.bias(behind) < -2e-3
    assert abs(shift) < 20e-3


def test_range_wrap_shows_far_surfaces_near():
    seen, usual = Look({'range_wrap': 1.0}, FAR), plain(FAR)
    back = ~seen.invalid & usual.invalid & (seen.sigma > 0)
    assert back.sum() > 1000
    # Exactly a wavelength's half along the ray.
    rays = scenes(MODES[0]).optics.ray_length
    jump = (seen.error * rays)[back]
    assert np.median(jump) == pytest.approx(-2.498, abs=0.02)


def test_dropouts_lose_the_pixels_they_should():
    low = Look({'low_signal_dropout': 1.0}, BOARD)
    grazing = Look({'grazing_dropout': 1.0}, STAIRS)
    full = Look({'saturation': 1.0}, CLOSE)
    slant = grazing.cosine / np.maximum(grazing.clean, 0.1)
    for seen, recording, what, weak in (
        (low, BOARD, low.amplitude, True),
        (full, CLOSE, full.amplitude, False),
        (grazing, STAIRS, slant, True),
    ):
        usual = plain(recording)
        lost = seen.invalid & ~usual.invalid
        assert lost.mean() > 0.01
        kept = ~seen.invalid
        less = np.median(what[lost]) < np.median(what[kept])
        assert less == weak


def test_filters_correlate_frames_and_neighbours():
    temporal, spatial = Look({'temporal_filter': 1.0}, CLOSE), Look({'spatial_filter': 1.0}, CLOSE)
    flat = plain(CLOSE).flat
    around = temporal.residual
    assert correlation(around[1:], around[:-1], flat[1:]) == pytest.approx(0.4, abs=0.06)
    assert temporal.spread() < 0.85
    beside = spatial.residual
    assert correlation(beside[..., 1:], beside[..., :-1], flat[..., 1:] & flat[..., :-1]) > 0.4
    usual = plain(CLOSE).residual
    assert abs(correlation(usual[1:], usual[:-1], flat[1:])) < 0.03
    assert abs(correlation(usual[..., 1:], usual[..., :-1], flat[..., 1:])) < 0.03


def test_noise_effects_increase_the_variance():
    assert Look({'excess_noise': 1.0}, CLOSE).spread() == pytest.approx(1.35, abs=0.05)
    ambient = Look({'ambient_light': 2.0}, BOARD)
    dark = ambient.amplitude < np.quantile(ambient.amplitude[ambient.flat], 0.1)
    around = ambient.residual - ambient.residual.mean(axis=0)
    assert np.nanstd(around[ambient.flat & dark]) > 1.5 * np.nanstd(around[ambient.flat & ~dark])
    tails = Look({'heavy_tails': 1.0}, CLOSE)
    share = [(np.abs(look.residual[look.flat]) > 4.5).mean() for look in (tails, plain(CLOSE))]
    assert 0.002 < share[0] < 0.01
    assert share[1] < 0.0005
    jumping = Look({'lateral_noise': 1.0}, CLOSE)
    usual, more = (
        (np.abs(look.residual) > 8)[look.edge].mean() for look in (plain(CLOSE), jumping)
    )
    assert more > 1.05 * usual


def test_quantised_depth_or_phase_has_a_lattice():
    here = scenes(MODES[0])
    found = set()
    for seed in range(6):
        camera = BlindCamera(Case(here.key, {'quantisation': 1.0}, seed), here)
        of_phase = bool(camera.effects[0].parameters['of_phase'])
        depth = next(iter(camera.frames(CLOSE))).depth
        path = depth * here.optics.ray_length
        steps = (path if of_phase else depth) / 0.005
        # Beyond half a wavelength's half, phases count from the other end.
        off = np.abs(steps - np.rint(steps))[path < 1.2]
        assert len(off) > 1000
        assert off.max() < 0.05
        found.add(of_phase)
    assert found == {True, False}


def test_motion_and_latency_need_motion():
    for name in ('motion_artefact', 'time_offset'):
        still = Look({name: 2.0}, CLOSE)
        np.testing.assert_allclose(still.depth, plain(CLOSE).depth, atol=1e-4)
        moves = Look({name: 2.0}, FORWARD)
        speed = scenes(MODES[0]).scenes[FORWARD].path.velocity[2]
        # What is ahead was farther away, or will be nearer, by the distance gone meanwhile.
        late = {'motion_artefact': -1, 'time_offset': 1}[name]
        assert np.sign(moves.bias() * late) == np.sign(speed)
    assert abs(moves.bias()) == pytest.approx(0.1 * abs(speed), rel=0.5)


def test_pose_and_intrinsics_move_the_scene():
    biases = [Look({'pose_error': 1.0}, recording).bias() for recording in STILL]
    assert np.std(biases) > 3e-3
    seen = Look({'intrinsics_error': 2.0}, BOARD)
    assert np.nanstd(np.nanmean(seen.error, axis=0)[seen.flat[0]]) > 3 * np.nanstd(
        np.nanmean(plain(BOARD).error, axis=0)[seen.flat[0]]
    )


def with_inside(effect, recording, **inside):
    """Return what a camera with an effect sees that differs inside from its profile."""
    return Look({effect: 1.0}, recording, inside=Internals(**inside))


def test_random_losses_depend_on_nothing():
    seen = with_inside('random_dropout', CLOSE, lost=0.3)
    dark = seen.amplitude < np.median(seen.amplitude[seen.flat])
    for where in (dark, ~dark, seen.edge):
        some = where & ~plain(CLOSE).invalid
        # Of 20,000 pixels, a fraction is known to 0.3 %.
        assert seen.invalid[some].mean() == pytest.approx(0.3, abs=0.03)
    dead = with_inside('random_dropout', CLOSE, lost=0.3, dead=True)
    alike = (dead.invalid == dead.invalid[0]) | plain(CLOSE).invalid
    assert alike.all()

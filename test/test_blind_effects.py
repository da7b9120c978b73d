"""Each effect of the blind camera shows as it should. All draws are seeded."""

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
import numpy as np
import pytest
from study.blind import BlindCamera, Case, Internals


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

    assert far_apart(plain(CLOSE))
    assert between(Look({'flying_pixels': 1.0}, CLOSE)) > between(plain(CLOSE)) + 0.01


def far_apart(look):
    return bool(np.nanquantile(look.clean, 0.95) - np.nanquantile(look.clean, 0.05) > 0.3)


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

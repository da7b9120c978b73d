"""
The effects: one test over the whole registry, and what holds for sets of them.

An effect that is added without a signature in `signatures` fails here.
"""

from dataclasses import replace
import math

from boards import K
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.camera import camera as pipeline
from flexx2_sim_ros.camera.frame import gray_image
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.effect import CHANNELS
from flexx2_sim_ros.physics.frame_state import Stage
import numpy as np
import pytest
from signatures import pair, QUIET, SIGNATURES
from small_scenes import capture, FIELDS, same, scenes, SHADES, SMALL

WHITE = flexx2().sensor.full_scale_amplitude

NAMES = list(registry())
PERIOD = 33_333_333
ORDER = [
    'pose_error', 'intrinsics_error', 'time_offset', 'flying_pixels', 'multipath', 'stray_light',
    'motion_artefact', 'wiggling', 'fixed_pattern', 'amplitude_bias', 'offset', 'warm_up_drift',
    'depth_scale', 'excess_noise', 'ambient_light', 'heavy_tails', 'lateral_noise',
    'phase_noise_wiggling', 'range_wrap', 'spatial_filter', 'temporal_filter', 'quantisation',
    'low_signal_dropout', 'grazing_dropout', 'saturation', 'random_dropout', 'motion_dropout',
]  # fmt: skip


# (a) It changes what its parameters say; see `signatures`.


def has_its_signature(name):
    assert name in SIGNATURES, f'write the signature of {name} in test/signatures'
    SIGNATURES[name]()


# (b) Nothing else.

COLUMNS, ROWS, FRAMES = 128, 48, 40
EDGE, AWAY = 64, 24  # pixels: the largest displacement of an edge is 17
TOLERANCES = {
    'bias': 0.25e-3,
    'noise': 0.02,
    'outliers': 0.002,
    'frames': 0.03,
    'neighbours': 0.03,
    'validity': 0.004,
    'amplitude': 0.002,
    'edges': 0.03,
}


def channels(effects):
    """
    Measure every channel on a still scene: two slanted boards, one before the other.

    Cameras with and without an effect share their noise, so a channel that is not touched hardly
    differs at all.
    """
    u = np.arange(COLUMNS) - (COLUMNS - 1) / 2
    matrix = np.array([[210.6, 0, u[-1]], [0, 212.9, (ROWS - 1) / 2], [0, 0, 1]])
    row = np.where(np.arange(COLUMNS) < EDGE, 1.0, 1.35) / (1 + 0.25 * u / 210.6)
    clean = np.broadcast_to(row, (ROWS, COLUMNS))
    shade = np.full((ROWS, COLUMNS), 0.7)
    frame = Camera('Mode_9_30fps', effects=effects, seed=5).capture(
        clean, matrix, np.arange(FRAMES) * PERIOD, shade
    )
    calm = np.ones(COLUMNS, bool)
    calm[:4] = calm[-4:] = calm[EDGE - AWAY : EDGE + AWAY] = False
    error = (frame.depth.astype(np.float64) - clean)[:, 6:-6, calm]
    scale = flexx2().mode('Mode_9_30fps').noise.sigma_z(clean, math.atan(0.25))[6:-6, calm]
    rest = error - np.nanmean(error, axis=0)
    known = np.nan_to_num(rest)
    power = np.nanmean(rest**2)
    means = np.nanmean(error, axis=0)
    around = frame.depth[:, :, EDGE - AWAY : EDGE + AWAY]
    # A lost pixel says nothing of where the edge is.
    seen = np.where(np.isnan(around), np.nanmedian(around, axis=0), around)
    near = (seen < 1.2).sum(axis=2) - AWAY
    between = (seen > 1.05) & (seen < 1.3)
    return {
        'bias': np.append(means.reshape(3, 12, -1, 8).mean(axis=(1, 3)), means.std()),
        'noise': np.log(np.sqrt(power)) * np.ones(1),
        'outliers': np.array([(np.abs(rest) > 4.5 * scale).mean()]),
        'frames': np.array([(known[1:] * known[:-1]).mean() / power]),
        'neighbours': np.array([(known[:, :, 1:] * known[:, :, :-1]).mean() / power]),
        'validity': np.array([np.isnan(error).mean()]),
        'amplitude': np.log(np.median(frame.amplitude[:, 6:-6, calm], axis=0)),
        'edges': np.array([near.mean(), near.std(), between.sum(axis=2).mean()]),
    }


@pytest.fixture(scope='module')
def plain():
    """Return every channel without an effect."""
    return channels(())


def changes_nothing_else(name, plain):
    kind = registry()[name]
    assert set(kind.changes) <= set(CHANNELS) == set(TOLERANCES)
    found = channels({name: {'strength': 1.5}})
    changed = {
        channel
        for channel, tolerance in TOLERANCES.items()
        if np.abs(found[channel] - plain[channel]).max() > tolerance
    }
    assert changed <= set(kind.changes)
    # It shows here as well, but for what takes far, steep, bright or dark surfaces, or corners.
    elsewhere = {'range_wrap', 'grazing_dropout', 'low_signal_dropout', 'saturation', 'multipath'}
    assert changed or name in elsewhere or not kind.changes


# (c) Off is off.


def costs_nothing_when_off(name, monkeypatch):
    clean, stamps = scenes(3), np.arange(3) * PERIOD
    wanted = capture((), clean, stamps)

    def never(*_):
        raise AssertionError('the way of effects is taken, although none is on')

    monkeypatch.setattr(pipeline, 'run_stages', never)
    for off in (
        {name: {'strength': 0}},
        [registry()[name](strength=0.0)],
        {other: {'strength': 0} for other in NAMES},
    ):
        assert Camera(effects=off).effects == ()
        assert same(capture(off, clean, stamps), wanted)
    with pytest.raises(AssertionError):
        capture({name: None}, clean, stamps)


# (d) Seeded, whatever was dropped.


def is_seeded(name):
    effects = {name: {'strength': 1.5}}
    stamps = np.arange(8) * PERIOD
    whole = capture(effects, scenes(8), stamps)
    assert same(whole, capture(effects, scenes(8), stamps))
    for new in ({'seed': 4}, {'name': 'right'}):
        stranger = capture(effects, scenes(8), stamps, **new)
        alike = np.isclose(stranger.depth, whole.depth, atol=1e-7).mean()
        assert alike <= 0.1 or name == 'quantisation'
    if name == 'temporal_filter':
        return  # What it mixes depends on the frame before.
    some = np.array([0, 3, 4, 7])
    kind = registry()[name]
    clean = np.broadcast_to(scenes(1), (8, 24, 32)) if kind.keeps else scenes(8)
    whole, part = (
        capture(effects, clean[chosen], stamps[chosen]) for chosen in (np.arange(8), some)
    )
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(whole, field)[some], getattr(part, field))


@pytest.mark.parametrize(
    ('settings', 'lags'),
    [
        # Of a mean of n frames: 1 - k / n. Of two filters in a row: of their impulse response.
        ({'window': 3.0, 'gate': 1000.0}, (2 / 3, 1 / 3, 0.0)),
        ({'window': 2.5, 'gate': 1000.0}, (1.5 / 2.25, 0.5 / 2.25, 0.0)),
        ({'share': 0.5, 'second': 0.5, 'gate': 1000.0}, (0.8, 0.55, 0.35)),
        ({'share': 0.5, 'second': 0.0, 'gate': 1000.0}, (0.5, 0.25, 0.125)),
    ],
)
def test_filters_over_frames_have_the_correlation_of_their_kernel(settings, lags):
    """Assert it within 0.02, about six standard errors of 24 x 32 pixels and 380 frames."""
    clean, stamps = np.full((400, 24, 32), 1.5), np.arange(400) * PERIOD
    frame = capture({'temporal_filter': {**settings, 'strength': 1.0}}, clean, stamps)
    error = (frame.depth - clean)[20:].astype(float)
    for apart, wanted in enumerate(lags, start=1):
        found = (error[apart:] * error[:-apart]).mean() / np.square(error).mean()
        assert found == pytest.approx(wanted, abs=0.02)


def test_a_mean_of_frames_follows_a_change_at_once():
    clean = np.concatenate([np.full((5, 24, 32), 1.5), np.full((5, 24, 32), 1.8)])
    frame = capture({'temporal_filter': {'window': 4.0}}, clean, np.arange(10) * PERIOD)
    plain = capture((), clean, np.arange(10) * PERIOD)
    jump = np.isfinite(plain.depth[5]) & np.isfinite(frame.depth[5])
    assert jump.mean() > 0.9
    assert np.allclose(frame.depth[5][jump], plain.depth[5][jump])


# (e) A batch is a loop.


def batch_equals_loop(name):
    effects = {name: {'strength': 1.5}}
    clean = np.stack([scenes(5), scenes(5)[::-1] + 0.4, np.broadcast_to(scenes(1), (5, 24, 32))])
    stamps = np.arange(5) * PERIOD
    wanted = [capture(effects, one, stamps) for one in clean]
    at_once = capture(effects, clean, stamps)
    camera = Camera('Mode_9_30fps', effects=effects, seed=3)
    by_step = [camera.capture(clean[:, t], SMALL, stamps[t], SHADES) for t in range(5)]
    for field in FIELDS:
        loop = np.stack([getattr(one, field) for one in wanted])
        np.testing.assert_array_equal(getattr(at_once, field), loop)
        np.testing.assert_array_equal(
            np.stack([getattr(one, field) for one in by_step], axis=1), loop
        )


@pytest.mark.parametrize(
    'check',
    [
        has_its_signature,
        changes_nothing_else,
        costs_nothing_when_off,
        is_seeded,
        batch_equals_loop,
    ],
    ids=lambda check: check.__name__,
)
@pytest.mark.parametrize('name', NAMES)
def test_effect(name, check, plain, monkeypatch):
    extra = {changes_nothing_else: (plain,), costs_nothing_when_off: (monkeypatch,)}
    check(name, *extra.get(check, ()))


# All together


def test_the_registry():
    assert ORDER == NAMES
    assert set(SIGNATURES) == set(NAMES)
    stages = [kind.stage for kind in registry().values()]
    assert stages == sorted(stages)
    assert set(stages) <= set(Stage)
    for kind in registry().values():
        strength, *others = kind.parameters()
        assert strength.name == 'strength'
        assert (strength.default, strength.low, strength.high) == (1.0, 0.0, 4.0)
        assert all(p.low <= p.default <= p.high and p.low < p.high and p.text for p in others)
        assert kind.title
        assert kind.source


@pytest.mark.parametrize(('usecase', 'strength'), [('Mode_5_60fps', 0.01), ('Mode_9_30fps', 4.0)])
def test_all_effects_together_accept_any_scene(usecase, strength):
    mode = flexx2().mode(usecase)
    camera = Camera(usecase, effects={name: {'strength': strength} for name in NAMES}, seed=1)
    for shape in ((1, 1), (1, 9), (7, 1), (3, 2), (24, 32)):
        for odd in (1.0, math.nan, math.inf, 0.0, -1.0, 1e-9, 1e-3, 8.0, 1e5, 3e38, 1e300):
            clean = np.full((4, *shape), 1.5)
            clean[:, shape[0] // 2, shape[1] // 2] = odd
            clean[2:] += 0.05
            shade = np.linspace(0, 1, clean[0].size).reshape(shape)
            shade.flat[-1] = (math.nan, -1.0, 7.0)[shape[1] % 3]
            frame = camera.capture(clean, SMALL, np.arange(4) * PERIOD, shade)
            valid = np.isfinite(frame.depth)
            assert ((frame.depth >= mode.range_min) & (frame.depth <= mode.range_max))[valid].all()
            assert np.array_equal(np.isfinite(frame.sigma), valid)
            assert (frame.sigma[valid] >= 0).all()
            assert np.isfinite(frame.amplitude).all()
            assert (frame.amplitude >= 0).all()
            assert ((frame.confidence >= 0) & (frame.confidence <= 1)).all()
            assert not frame.confidence[~valid].any()


@pytest.mark.parametrize(
    'frequencies',
    [(20e6,), (60.24e6,), (80.32e6, 60.24e6), (100e6, 20e6), (16e6, 80e6, 120e6)],
    ids=str,
)
def test_other_frequencies(frequencies):
    spans = [299_792_458 / 2 / f for f in frequencies]
    wrap = {1: spans[0], 2: 7.46 if frequencies[0] < 90e6 else 7.495, 3: 18.737}[len(spans)]
    mode = replace(QUIET.modes[0], modulation_hz=frequencies, range_max=0.95 * wrap)
    profile = replace(QUIET, modes=(mode,))
    for distance in (0.5, 0.9 * wrap, wrap + 0.7):
        camera = Camera(mode.name, profile=profile, effects={'range_wrap': None})
        frame = camera.capture(np.full((4, 4), distance), SMALL, 0)
        np.testing.assert_allclose(frame.depth, distance % wrap, rtol=0.01)
    noisy = replace(mode, noise=flexx2().modes[0].noise)
    profile = replace(profile, modes=(noisy,))
    camera = Camera(mode.name, profile=profile, effects=dict.fromkeys(NAMES))
    frame = camera.capture(scenes(3), SMALL, np.arange(3) * PERIOD, SHADES)
    assert np.isfinite(frame.depth).mean() > 0.5


# Light


def test_exposure_scales_the_light_that_effects_see():
    def frames(name, share, distance, **parameters):
        camera = Camera(effects={name: parameters}, seed=1)
        camera.exposure_share = share
        return camera.capture(np.full((40, 40), distance), K, 0)

    bright, dim = (frames('saturation', share, 0.4, gloss=0) for share in (1.0, 0.25))
    assert np.isnan(bright.depth).mean() > 0.8
    assert np.isnan(dim.depth).mean() < 0.1
    bright, dim = (frames('low_signal_dropout', share, 2.0, half=0.1) for share in (1.0, 0.1))
    assert np.isnan(bright.depth).mean() < 0.15 < 0.8 < np.isnan(dim.depth).mean()
    bright, dim = (frames('ambient_light', share, 1.0, k=0.01) for share in (1.0, 0.5))
    np.testing.assert_allclose(dim.sigma, np.hypot(bright.sigma, bright.sigma * 1.7), rtol=0.03)


def test_gray_and_confidence_follow_the_light():
    """Assert saturated pixels are white, too dark ones black, and noisier ones less certain."""
    u = np.mgrid[:172, :224][1]
    near, far = np.full((172, 224), 0.35), np.full((172, 224), 3.0)
    blinded, _ = pair('saturation', near)
    lost = np.isnan(blinded.depth)
    assert lost.mean() > 0.9
    assert (gray_image(blinded.amplitude, 1.0, WHITE)[lost] == 255).all()
    assert not blinded.confidence[lost].any()
    assert np.isnan(blinded.sigma[lost]).all()
    shade = np.where(u < 112, 1.0, 0.01)
    dark, _ = pair('low_signal_dropout', far, 0, shade, usecase='Mode_9_30fps')
    lost = np.isnan(dark.depth)
    assert lost[:, 120:].mean() > 0.9 > 0.1 > lost[:, :100].mean()
    assert not gray_image(dark.amplitude, 1.0, WHITE)[lost].any()
    shade = np.where(u < 112, 1.0, 0.2)
    noisy, plain = pair('ambient_light', far, 0, shade, usecase='Mode_9_30fps')
    valid = np.isfinite(noisy.depth) & np.isfinite(plain.depth)
    less = plain.confidence - noisy.confidence
    assert (less[valid] > 0).all()
    assert less[:, 120:][valid[:, 120:]].min() > 3 * less[:, :100][valid[:, :100]].max()


@pytest.mark.parametrize(('x', 'y'), [(0.012, 0.0), (0.0, -0.012)])
def test_a_camera_that_moved_sideways_sees_outlines_move_with_the_surface_in_front(x, y):
    clean = np.full((172, 224), 3.0, np.float32)
    clean[60:110, 80:150] = 0.6
    moved = {'pose_error': {'x': x, 'y': y, 'z': 0, 'pitch_deg': 0, 'yaw_deg': 0, 'roll_deg': 0}}
    before, after = (
        Camera(effects=effects, seed=1).capture(clean, K, 0).depth for effects in ({}, moved)
    )
    for axis, focal, step in ((0, K[0, 0], x), (1, K[1, 1], y)):
        first, last = (
            np.flatnonzero((one < 1.8).sum(axis=axis) > 20)[[0, -1]] for one in (before, after)
        )
        assert last - first == pytest.approx([-focal * step / 0.6] * 2, abs=1.5)

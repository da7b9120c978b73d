"""Parts of the diagnosis: pose, statistics, the patch, the page."""

from bench.gap_campaigns import BoxRoom, look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import parse_effects, registry
from flexx2_sim_ros.gap.data.axes import axes_of
from flexx2_sim_ros.gap.data.covariates import look_at
from flexx2_sim_ros.gap.data.pose import unknown_border
from flexx2_sim_ros.gap.data.registration import place, RecordingData, register
from flexx2_sim_ros.gap.features.catalogue import catalogue
from flexx2_sim_ros.gap.features.features import Feature, features, LAYOUT
from flexx2_sim_ros.gap.features.sums import accumulate
import numpy as np
import pytest

PRIOR = np.array([0.01] * 3 + [0.5] * 3)


def test_every_effect_is_in_the_catalogue_and_what_is_simulated_is_valid():
    columns, candidates = catalogue()
    assert {c.effect for c in candidates} == set(registry())
    for column in columns:
        assert parse_effects(column.effects)
    for candidate in candidates:
        registry()[candidate.effect].from_mapping(
            candidate.build(tuple(term.nodes[0][0] for term in candidate.terms))
        )
    assert not any(c.effect == 'offset' for c in catalogue(['offset'])[1])


def test_a_pose_error_is_found_to_a_fraction_of_a_millimetre():
    K = flexx2().intrinsics.matrix  # noqa: N806
    room = make_room(np.random.default_rng(2))
    rotation, position = optical(0.1, 0.35, 0.0), np.array([0.0, 0.1, 0.6])
    clean, rho = look(room, K, (172, 224), rotation, position)
    x, y, z = np.radians([0.1, -0.2, 0.15])
    turn = np.array([[1, -z, y], [z, 1, -x], [-y, x, 1]])
    step = np.array([0.001, -0.002, 0.003])
    true, _ = look(room, K, (172, 224), rotation @ turn, position + rotation @ step)
    stamps = np.arange(10) * 33_000_000
    depth = Camera(seed=1).capture(true, K, stamps, rho).depth
    recording = RecordingData(
        '',
        depth,
        clean,
        rho,
        K,
        stamps,
        np.arange(10) == 0,
        None,
        flexx2().mode('Mode_9_30fps'),
        None,
    )
    found, sure = register(recording, PRIOR)
    assert np.abs(sure).sum() < np.abs(found).sum()
    assert found[3:] == pytest.approx([0.1, -0.2, 0.15], abs=0.03)
    assert found[1] == pytest.approx(-0.002, abs=0.0006)
    # Forwards, half of it may as well be the camera's own constant error: not taken off here.
    assert 0.001 < found[2] < 0.0035


def test_outlines_show_a_motion_along_surfaces_that_face_the_camera():
    # Without the outlines of the two boxes, such a motion changes no depth.
    K = flexx2().intrinsics.matrix  # noqa: N806
    far = [-1.0, -4.0, -4.0, 3.0, 4.0, 4.0]
    boxes = [[0.8, 0.05, -0.2, 3.0, 0.4, 0.3], [1.4, -0.6, -0.3, 3.0, -0.1, 0.4]]
    room = BoxRoom(np.array([far, *boxes]), np.full((3, 2), 0.5), np.ones(3))
    rotation, step = optical(0.0, 0.0, 0.1), np.array([0.006, -0.008, 0.0])
    clean, rho = look(room, K, (172, 224), rotation, np.zeros(3))
    true, _ = look(room, K, (172, 224), rotation, rotation @ step)
    stamps = np.arange(10) * 33_000_000
    depth = Camera(seed=1).capture(true, K, stamps, rho).depth
    mode, fresh = flexx2().mode('Mode_9_30fps'), np.arange(10) == 0
    recording = RecordingData('', depth, clean, rho, K, stamps, fresh, None, mode, None)
    found, _ = register(recording, PRIOR)
    assert found[:2] == pytest.approx(step[:2], abs=0.001)
    placed = place(recording, found)
    # A pixel on an outline may be on either side.
    assert (np.abs(placed.clean - true) > 0.1).sum() < 0.5 * (np.abs(clean - true) > 0.1).sum()


def test_a_time_offset_is_not_taken_for_a_pose_error():
    # A camera that drives forwards at 0.6 m/s and shows what was 40 ms ago: 24 mm behind.
    K = np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]])  # noqa: N806
    room = make_room(np.random.default_rng(2))
    frames, interval = 14, 0.033
    seen = [
        look(room, K, (60, 80), optical(0.1, 0.2 + 0.5 * t, 0.0), np.array([0.6 * t, 0.1, 0.6]))
        for t in np.arange(-4, 4 * frames) * interval / 4
    ]
    clean, late = (
        [np.array(images) for images in zip(*seen[start::4], strict=True)] for start in (4, 4 - 5)
    )
    stamps = (np.arange(frames) * interval * 1e9).astype(np.int64)
    depth = Camera(seed=1).capture(late[0][-frames:], K, stamps, late[1][-frames:]).depth
    recording = RecordingData(
        '',
        depth,
        clean[0][:frames],
        clean[1][:frames],
        K,
        stamps,
        np.arange(frames) == 0,
        None,
        flexx2().mode('Mode_9_30fps'),
        None,
    )
    found, _ = register(recording, PRIOR)
    assert np.linalg.norm(found[:3]) < 0.012


def test_registration_ignores_borders_and_bends():
    K = np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]])  # noqa: N806
    floor = np.maximum(np.arange(60) - 40.0, 0)[:, None]
    clean = (1 / (0.5 + 0.02 * floor) + np.zeros(80)).astype(np.float32)
    camera = flexx2()
    mode = camera.mode('Mode_9_30fps')
    scene = look_at(clean, None, 0.0, None, K, mode, axes_of(camera), border=2)
    assert not scene.inside[38:43].any()
    assert not scene.inside[:2].any()
    assert not scene.inside[:, -2:].any()
    assert scene.inside[4:36, 4:76].all()
    assert scene.inside[46:56, 4:76].all()
    assert unknown_border(np.zeros(6), clean, K) == 0
    # A degree is 1.2 pixels here.
    assert unknown_border(np.array([0, 0, 0, 0, 1.0, 0]), clean, K) == 3


def two_walls(far):
    """Return a wall at 3 m and, from a column on, one with too much noise; clean, and its bins."""
    K = np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]])  # noqa: N806
    clean = np.full((60, 80), 3.0, np.float32)
    clean[:, far:] = 6.5
    camera = flexx2()
    mode = camera.mode('Mode_9_30fps')
    return clean, look_at(clean, None, 0.0, None, K, mode, axes_of(camera))


def test_of_pixels_with_too_much_noise_only_losses_count():
    rng = np.random.default_rng(0)
    clean, scene = two_walls(far=40)
    assert scene.trusted == pytest.approx(0.048, abs=5e-4)
    assert (scene.sigma[:, 45:75] > scene.trusted).all()
    depth = clean + scene.sigma * rng.standard_normal((20, 60, 80)).astype(np.float32)
    wild, lost = depth.copy(), depth.copy()
    wild[:, :, 42:] += rng.choice((-1, 1), (20, 60, 38)).astype(np.float32)
    lost[:5, :, 42:] = np.nan
    fresh = np.arange(20) == 0
    plain, wild, lost = (
        features(accumulate(one, [scene], fresh, 0))[0] for one in (depth, wild, lost)
    )
    chosen = [f.axis not in ('structure', 'beyond') for f in LAYOUT]
    np.testing.assert_array_equal(wild[chosen], plain[chosen])
    everywhere = LAYOUT.index(Feature('invalid', 'all', 0))
    assert lost[everywhere] > plain[everywhere] + 0.1


def test_too_much_noise_neither_hides_a_bias_nor_looks_like_a_trend():
    rng = np.random.default_rng(0)
    clean, scene = two_walls(far=30)
    # Two thirds of the image have too much noise. All depths lie a standard deviation too far.
    depth = clean + scene.sigma * (1 + rng.standard_normal((20, 60, 80)).astype(np.float32))
    depth[:8, 30:] = np.nan
    found, _ = features(accumulate(depth, [scene], np.arange(20) == 0, 0))
    bias, trend = (found[LAYOUT.index(Feature(name, 'all', 0))] for name in ('bias', 'trend'))
    # 20 x 1000 depths and more: their mean is a standard deviation of 0.007 off, a trend 0.025.
    # Farther off than 5 and 5.5 of these by chance: once in 10^6.
    assert bias == pytest.approx(1.0, abs=0.04)
    assert trend == pytest.approx(0.0, abs=0.14)

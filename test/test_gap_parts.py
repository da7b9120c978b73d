"""Parts of the diagnosis: pose, statistics, the patch, the page."""

from bench.gap_campaigns import BoxRoom, look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import parse_effects, registry
from flexx2_sim_ros.gap.data.registration import place, RecordingData, register
from flexx2_sim_ros.gap.features.catalogue import catalogue
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

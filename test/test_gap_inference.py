"""Parts of the diagnosis: poses, statistics without any shortcut, and where a gap lies."""

import ast
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import SimpleNamespace

from bench.gap_campaigns import BoxRoom, look, make_room, optical
from flexx2_sim_ros import gap
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import parse_effects, registry
from flexx2_sim_ros.gap.calibration import data, features, forms, inference, search
from flexx2_sim_ros.gap.calibration.about import ASSUMED, DEFINITION
from flexx2_sim_ros.gap.calibration.inference import LOSS
from flexx2_sim_ros.gap.data.axes import AXES, ENDLESS
from flexx2_sim_ros.gap.data.registration import place, RecordingData, register
from flexx2_sim_ros.gap.features.catalogue import catalogue
from flexx2_sim_ros.gap.features.pixel_groups import GROUP_CHANNELS, GROUP_TOLERANCE, PixelGroups
from flexx2_sim_ros.gap.inference.cover import cover, shows_along
from flexx2_sim_ros.gap.inference.normal_equations import (
    cauchy_weights,
    leave_one_out_steps,
    normal_equations,
    solve,
)
from flexx2_sim_ros.gap.inference.own_errors import OwnErrors
from flexx2_sim_ros.physics.poses import eliminate_nuisances
import numpy as np
import pytest

RECORDINGS, SHARED, OWN, FEATURES = 4, 3, 2, 40


def equations():
    """Return each recording's normal equations for made-up features."""
    rng = np.random.default_rng(0)
    design = rng.normal(size=(RECORDINGS, SHARED + OWN, FEATURES))
    residual = rng.normal(size=(RECORDINGS, FEATURES))
    return normal_equations(design, np.ones_like(residual), residual)


def all_at_once(normal, right):
    """Solve for the shared values and every recording's nuisances in one matrix."""
    count = len(normal)
    size = SHARED + OWN * count
    matrix, target = np.zeros((size, size)), np.zeros(size)
    for r in range(count):
        index = np.r_[:SHARED, SHARED + OWN * r : SHARED + OWN * (r + 1)]
        matrix[np.ix_(index, index)] += normal[r]
        target[index] += right[r]
    return np.asarray(np.linalg.solve(matrix, target))


def test_eliminated_nuisances_leave_the_solution_as_it_is():
    normal, right = equations()
    reduced = eliminate_nuisances(normal, right, SHARED)
    step = solve(reduced.normal.sum(axis=0), reduced.right.sum(axis=0))
    whole = all_at_once(normal, right)
    assert step == pytest.approx(whole[:SHARED], abs=1e-5)
    assert reduced.nuisance_step(step).ravel() == pytest.approx(whole[SHARED:], abs=1e-5)


def test_a_left_out_recording_has_no_part_in_the_values():
    normal, right = equations()
    last = 0.1
    steps = leave_one_out_steps(eliminate_nuisances(normal, right, SHARED), last)
    for r, step in enumerate(steps):
        rest = np.arange(RECORDINGS) != r
        # The last shared value is given: its column goes to the right side.
        given = right[rest] - normal[rest][:, :, SHARED - 1] * last
        fixed = normal[rest].copy()
        fixed[:, SHARED - 1], fixed[:, :, SHARED - 1] = 0, 0
        fixed[:, SHARED - 1, SHARED - 1], given[:, SHARED - 1] = 1, 0
        assert step == pytest.approx(all_at_once(fixed, given)[: SHARED - 1], abs=1e-5)


def test_outliers_hardly_count_in_reweighted_least_squares():
    rng = np.random.default_rng(1)
    design = np.ones((1, 1, 1000))
    values = rng.normal(2.0, 0.1, (1, 1000))
    values[:, :200] = 50.0
    estimate = np.zeros(1)
    for scale in (20.0, 6.0, 2.0, 1.0, 1.0, 1.0):
        residual = values - estimate[0]
        weight = cauchy_weights(
            np.ones_like(values), residual, np.full((1, 1000), 0.01 * scale**2)
        )
        normal, right = normal_equations(design, weight, residual)
        estimate = estimate + solve(normal[0], right[0])
    # Standard error of 800 values: 0.0035; outliers alone would shift the mean by 9.6.
    assert estimate[0] == pytest.approx(2.0, abs=0.05)


def test_a_pose_error_does_not_count_against_a_pose_that_is_exact():
    moved, still = np.array([0.01, 0, 0, 0, 0, 0]), np.zeros(6)
    poses = moved, still, moved
    evidence = [SimpleNamespace(pose=pose, planes=()) for pose in poses]
    exact = np.zeros((6, 6))
    own = OwnErrors(evidence, [None, exact, None], LOSS)
    amounts = np.zeros((3, own.count))
    assert own.loss(amounts, common_pose=False) > 1
    own.centre = own.pose[own.posed].mean(axis=0)
    assert own.loss(amounts, common_pose=False) == 0
    _, pull = own.prior(amounts, common_pose=False)
    assert pull == pytest.approx(0)


def test_poses_are_where_they_were_found():
    rng = np.random.default_rng(0)
    evidence = [
        SimpleNamespace(pose=rng.normal(size=6), planes=rng.normal(size=planes))
        for planes in (0, 3, 6)
    ]
    covariances = [None, np.eye(9), np.eye(12)]
    own = OwnErrors(evidence, covariances, LOSS)
    motions = own.found(rng.normal(size=(3, own.count)))
    assert [len(one) for one in motions] == [6, 9, 12]
    again = own.at(motions).found(np.zeros((3, own.count)))
    for one, other in zip(motions, again, strict=True):
        assert one == pytest.approx(other)


def test_every_constant_says_its_meaning_and_source():
    modules = data, features, forms, inference, search
    found = [one for module in modules for one in vars(module).values()]
    sections = [one for one in found if is_dataclass(one) and not isinstance(one, type)]
    assert len(sections) == 15
    for section in sections:
        for one in fields(section):
            assert one.metadata['meaning'], one.name
            source = one.metadata['source']
            commands = ('python -m bench.', 'flexx2 gap benchmark', 'test_gap_')
            assert source in (ASSUMED, DEFINITION) or any(c in source for c in commands), one.name


def test_no_constant_of_the_diagnosis_is_elsewhere():
    package = Path(gap.__file__).parent
    for room in ('data', 'features', 'inference', 'forms'):
        for path in (package / room).glob('*.py'):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.Assign):
                    values = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
                    assert not any(isinstance(v, float) for v in values), (path, node.lineno)


def groups(differs, size=0.5):
    """Return a group for each bin of distance and region, and an offset where it differs."""
    far, region = (a.ravel() for a in np.indices((AXES['distance'].bins, 12)))
    samples = np.zeros((len(far), 12, len(ENDLESS)), np.int16)
    for i, name in enumerate(ENDLESS):
        place = {'distance': far, 'region': region}.get(name)
        samples[:, :, i] = (
            -1
            if name in ('edge', 'speed')
            else AXES[name].start + (0 if place is None else place[:, None])
        )
    effect = np.zeros((len(far), len(GROUP_CHANNELS)))
    effect[:, 0] = size * differs.ravel()
    limit = np.broadcast_to(GROUP_TOLERANCE, effect.shape)
    return PixelGroups(
        np.full(len(far), 2000.0), effect, 0 * effect, 0.002 * effect[:, 0], limit, limit, samples
    )


def test_conditions_single_out_the_pixels_that_differ():
    differs = np.zeros((AXES['distance'].bins, 12), bool)
    nowhere, everywhere = groups(0 * differs), groups(0 * differs + 1)
    assert cover([nowhere], False) == []
    differs[3:6] = True
    (one,) = cover([groups(differs)] * 2, False)
    assert (one.axis, one.first, one.last) == ('distance', 3, 5)
    assert one.difference[0] == pytest.approx(0.5)
    assert cover([groups(differs)], True) == []  # the real camera shows none of it
    differs[:, 7] = True
    both = cover([groups(differs)] * 2, False)
    assert {(c.axis, c.first, c.last) for c in both} == {('distance', 3, 5), ('region', 7, 7)}
    # In one of two recordings only; everywhere.
    (one,) = cover([nowhere, everywhere], False)
    assert (one.axis, one.first, one.last) == ('recording', 1, 1)
    (one,) = cover([everywhere], False)
    assert one.axis == 'all'
    # Each recording has its own size.
    both = cover([nowhere, everywhere, groups(0 * differs + 1, 0.8)], False)
    assert [(c.axis, c.first, c.last) for c in both] == [('recording', 1, 1), ('recording', 2, 2)]
    assert [c.bias for c in both] == pytest.approx([0.001, 0.0016])


def test_a_named_effect_says_which_of_two_like_covariates_is_meant():
    """Assert it where distant pixels are those of some regions, and only if the data allow it."""
    differs = np.zeros((AXES['distance'].bins, 12), bool)
    differs[3:6, :8] = True
    known = registry()
    for named, axis in (
        ((), 'distance'),
        (('wiggling',), 'distance'),
        (('intrinsics_error',), 'region'),
        (('flying_pixels',), 'distance'),  # no pixel is at an edge
    ):
        expected = {one for name in named for one in shows_along(known[name])}
        first, *_ = cover([groups(differs)], False, expected=expected)
        assert first.axis == axis, named


def test_a_drift_is_said_of_uptimes():
    differs = np.ones((AXES['distance'].bins, 12), bool)
    some = [groups(differs, size) for size in (3.0, 2.0, 0.0, 0.0)]
    uptimes = [10.0, 60.0, 300.0, 900.0]
    drift = shows_along(registry()['warm_up_drift'])
    (one,) = cover(some, False, expected=drift, uptimes=uptimes)
    assert (one.axis, one.first, one.last) == ('uptime', 0, 1)
    # Recordings that do not say when are listed one by one.
    both = cover(some, False, expected=drift, uptimes=[None] * 4)
    assert [(one.axis, one.first) for one in both] == [('recording', 0), ('recording', 1)]


PRIOR = np.array([0.01] * 3 + [0.5] * 3)


def recorded(depth, clean, reflectivity, K, stamps):  # noqa: N803
    mode, fresh = flexx2().mode('Mode_9_30fps'), np.arange(len(stamps)) == 0
    return RecordingData('', depth, clean, reflectivity, K, stamps, fresh, None, mode, None)


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
    found, sure = register(recorded(depth, clean, rho, K, stamps), PRIOR)
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
    recording = recorded(depth, clean, rho, K, stamps)
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
    recording = recorded(depth, clean[0][:frames], clean[1][:frames], K, stamps)
    found, _ = register(recording, PRIOR)
    assert np.linalg.norm(found[:3]) < 0.012

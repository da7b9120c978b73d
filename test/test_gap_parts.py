"""Parts of the diagnosis: pose, statistics, the patch, the page."""

from bench.gap_campaigns import look, make_room, optical
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.patch import ResidualPatch
from flexx2_sim_ros.gap.catalogue import catalogue
from flexx2_sim_ros.gap.evidence import register, Take
from flexx2_sim_ros.gap.student import q_values, t_quantile, t_tail
import numpy as np
import pytest


def test_every_effect_is_in_the_catalogue_and_what_is_simulated_is_valid() -> None:
    columns, candidates = catalogue()
    assert {c.effect for c in candidates} == set(registry())
    for column in columns:
        for name, values in column.effects.items():
            registry()[name].from_mapping(values)
    for candidate in candidates:
        registry()[candidate.effect].from_mapping(
            candidate.build(tuple(term.nodes[0][0] for term in candidate.terms)))
    assert not any(c.effect == 'offset' for c in catalogue(['offset'])[1])


def test_student_and_false_discoveries() -> None:
    # Tables of the t distribution.
    assert t_tail(np.array([0.0]), 5)[0] == pytest.approx(0.5, abs=1e-4)
    assert t_quantile(0.95, 7) == pytest.approx(1.8946, abs=2e-3)
    assert t_quantile(0.95, 1) == pytest.approx(6.3138, abs=2e-2)
    assert q_values(np.array([0.01, 0.04, 0.03, 0.5])) == pytest.approx(
        [0.04, 0.16 / 3, 0.16 / 3, 0.5])


def test_a_pose_error_is_found_to_a_fraction_of_a_millimetre() -> None:
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
    take = Take('', depth, clean, rho, K, stamps, np.arange(10) == 0, None,
                flexx2().mode('Mode_9_30fps'), None)
    found = register(take, np.array([0.01] * 3 + [0.5] * 3))
    assert found[3:] == pytest.approx([0.1, -0.2, 0.15], abs=0.03)
    assert found[1:3] == pytest.approx([-0.002, 0.003], abs=0.0006)


def test_a_patch_shifts_scales_and_loses() -> None:
    values = {'edge_0': 1.5, 'bias_0': 0.02, 'scale_1': 2.0, 'loss_1': 0.25}
    clean = np.full((60, 80), 1.0, np.float32)
    clean[:, 40:] = 2.0
    K = np.array([[200.0, 0, 39.5], [0, 200.0, 29.5], [0, 0, 1]])  # noqa: N806
    stamps = np.arange(40) / 30
    plain, patched = (Camera(effects=effects, seed=2).capture(clean, K, stamps).depth
                      for effects in ((), (ResidualPatch(**values),)))
    near, far = (slice(None), slice(None), slice(0, 28)), (slice(None), slice(None), slice(52, 80))
    # 67,000 samples of 2 mm noise: the mean is good to 8 um, so 0.1 mm are 12 standard errors.
    assert np.mean(patched[near] - plain[near]) == pytest.approx(0.02, abs=1e-4)
    ratio = np.nanstd(patched[far]) / np.nanstd(plain[far])
    assert ratio == pytest.approx(2.0, abs=0.05)
    assert np.isnan(patched[far]).mean() == pytest.approx(0.25, abs=0.01)

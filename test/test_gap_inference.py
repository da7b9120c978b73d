"""Statistics of the diagnosis, against solutions without any shortcut."""

import ast
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

from flexx2_sim_ros import gap
from flexx2_sim_ros.gap.calibration import SECTIONS
from flexx2_sim_ros.gap.calibration.about import ASSUMED, DEFINITION
from flexx2_sim_ros.gap.calibration.inference import LOSS
from flexx2_sim_ros.gap.inference.normal_equations import (
    cauchy_weights,
    eliminate_nuisances,
    leave_one_out_steps,
    normal_equations,
    solve,
)
from flexx2_sim_ros.gap.inference.own_errors import OwnErrors
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
    for section in SECTIONS:
        for one in fields(section):
            assert one.metadata['meaning'], one.name
            source = one.metadata['source']
            commands = ('python -m bench.', 'flexx2 gap benchmark')
            assert source in (ASSUMED, DEFINITION) or any(c in source for c in commands), one.name


def test_no_constant_of_the_diagnosis_is_elsewhere():
    package = Path(gap.__file__).parent
    for room in ('data', 'features', 'inference', 'forms'):
        for path in (package / room).glob('*.py'):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.Assign):
                    values = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
                    assert not any(isinstance(v, float) for v in values), (path, node.lineno)

"""Which recording would settle what a diagnosis leaves open."""

import json
from pathlib import Path
from typing import Any

from bench.gap_next import as_room
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.planning.information import entropy, information
from flexx2_sim_ros.gap.planning.next_recording import suggest
from flexx2_sim_ros.gap.planning.plan import default_plan, Plan, read_plan
from flexx2_sim_ros.gap.planning.possible import usual_kinds
from flexx2_sim_ros.gap.planning.scenes import render
from flexx2_sim_ros.gap.planning.truths import KINDS, write_campaign
from flexx2_sim_ros.validation.blind import SceneKey, SceneSet
import numpy as np
import pytest

PLAN = """\
schema: 1
title: Three scenes
usecase: Mode_9_30fps
simulation: {scale: 0.25, frames: 6}
recordings:
  - {name: frontal, title: Wall, set_up: A wall., seconds: 5, for: [offset],
     walls: [[1.0, 0, 0.8]]}
  - {name: corner, title: Corner, set_up: A corner., seconds: 5, for: [multipath],
     walls: [[1.2, 45, 0.85], [1.2, -45, 0.85]]}
  - {name: hand, title: Hand, set_up: A hand., seconds: 5, for: [motion_artefact],
     walls: [[2.0, -40, 0.8]], cards: [[0.8, 0, 0.15, 0.5, 0.5]]}
"""
OFFSET = {'name': 'offset', 'parameters': {'bias': 0.005}, 'instead_of': ['multipath']}


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    (tmp_path / 'plan.yaml').write_text(PLAN)
    return read_plan(tmp_path / 'plan.yaml')


def write_diagnosis(folder: Path, **changed: Any) -> Path:
    """Write what a diagnosis with alternatives writes."""
    table = {
        'schema': 2,
        'verdict': 'identified',
        'effects': [{'name': 'multipath', 'parameters': {'gain': 1.0}}],
        'alternatives': [],
        'not_decidable': [],
        'recordings': [],
        'gap': {'loss': {'before': 40.0, 'after': 20.0, 'null': 15.0}},
        'settings': {'usecase': 'Mode_9_30fps', 'pose_prior': [0.01, 0.5], 'known': {}},
        **changed,
    }
    folder.mkdir()
    (folder / 'diagnosis.json').write_text(json.dumps(table))
    (folder / 'effects.yaml').write_text('schema: 1\neffects:\n  multipath: {}\n')
    return folder


def test_a_corner_tells_multipath_from_an_offset(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_diagnosis(tmp_path / 'diagnosis', alternatives=[OFFSET])
    campaign, out = tmp_path / 'campaign', tmp_path / 'out'
    campaign.mkdir()
    write_campaign(campaign, plan, flexx2(), KINDS[0])
    (campaign / 'hand.npz').unlink()
    own = tmp_path / 'own <b>.npz'
    with np.load(campaign / 'frontal.npz') as archive:
        np.savez(own, clean_depth=archive['clean_depth'], K=archive['K'])
    words = ['gap', 'next', str(folder), '--out', str(out), '--jobs', '1']
    words += ['--plan', str(tmp_path / 'plan.yaml'), '--scene', str(own)]
    assert main([*words, '--campaign', str(campaign)]) == 0
    table = json.loads((out / 'next.json').read_text())
    assert list(table['explanations']) == ['multipath', 'offset', 'no effect']
    rows = {row['name']: row for row in table['ranking']}
    assert set(rows) == {'frontal', 'corner', 'hand', own.name}
    # A frontal wall cannot show multipath: there is nothing that light bounces from, and an
    # offset looks like a wrong pose.
    assert next(iter(rows)) == 'corner'
    bits = [row['bits'] for row in table['ranking']]
    assert bits == sorted(bits, reverse=True)
    assert rows['corner']['best_told_apart'] == ['multipath', 'offset']
    assert rows['corner']['bits'] > 1.2 * rows['frontal']['bits']
    assert (
        max(bits) <= table['most_bits'] < np.log2(3)
    )  # A gap was found, so some effect is there.
    for row in [*rows.values(), *table['baselines'].values()]:
        assert row['right'] + row['wrong'] + row['undecided'] == pytest.approx(1)
    assert set(table['baselines']) == {'random', 'repeat'}
    page = (out / 'next.html').read_text()
    assert 'own &lt;b&gt;.npz' in page
    assert '<b>' not in page
    assert page.index('corner') < page.index('frontal')
    # Mean error and noise of each explanation; the set-up of those that the plan has.
    assert page.count('alt="mean error with') == 3 * 3
    assert 'set-up of corner' in page
    assert 'corner' in capsys.readouterr().err


def test_a_laser_decides_what_fitted_planes_leave_open(plan: Plan, tmp_path: Path) -> None:
    hidden = [{'name': 'offset', 'absorbed': 1.0, 'settled_by': 'a tape measure'}]
    folder = write_diagnosis(
        tmp_path / 'planes', verdict='not_decidable', effects=[], not_decidable=hidden
    )
    found = suggest(folder, plan, kinds=['planes', 'laser']).table
    assert set(found['explanations']) == {'offset', 'no effect'}
    assert found['most_bits'] == 1.0
    bits = {(row['name'], row['truth']): row['bits'] for row in found['ranking']}
    assert set(bits) == {(n, k) for n in ('frontal', 'corner') for k in ('planes', 'laser')}
    assert bits['frontal', 'planes'] < 0.1
    assert bits['frontal', 'laser'] > 0.5


def test_kinds_of_truth_follow_from_the_recordings() -> None:
    def kinds(**truth: Any) -> list[str]:
        return usual_kinds({'recordings': [{'used': True, 'truth': truth}, {'used': False}]})

    assert kinds(planes=3, pose=None) == ['tape', 'laser']
    assert kinds(planes=0, pose=0.001) == ['scan']
    assert kinds(planes=0, pose=None) == ['exact']


def test_a_diagnosis_that_leaves_nothing_open_is_refused(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(InputError, match='must leave something open'):
        suggest(write_diagnosis(tmp_path / 'sure'), plan)
    nothing = {'verdict': 'none', 'effects': []}
    with pytest.raises(InputError, match='must have alternatives'):
        suggest(write_diagnosis(tmp_path / 'none', **nothing), plan)


def test_what_cannot_be_used_is_said_and_nothing_written(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_diagnosis(tmp_path / 'diagnosis', alternatives=[OFFSET])
    own = tmp_path / 'own.npz'
    np.savez(own, clean_depth=np.ones((20, 30)))
    for words, says in (
        (['--scene', str(own)], 'K: must be in the file'),
        (['--truth', 'guess'], '--truth: must be among exact, scan, tape, planes, laser'),
        (['--campaign', str(tmp_path / 'nowhere')], 'nowhere'),
    ):
        assert main(['gap', 'next', str(folder), '--jobs', '1', *words]) == 2
        assert says in capsys.readouterr().err.replace('\n', ' ')
    assert sorted(one.name for one in folder.iterdir()) == ['diagnosis.json', 'effects.yaml']


def test_the_blind_camera_sees_the_set_ups_of_the_plan() -> None:
    plan = read_plan(default_plan())
    still = [one for one in plan.recordings if all(one.fixed)]
    scenes = SceneSet(SceneKey(plan.usecase, 1, 0.0, 56, 43, len(still), 3))
    scenes.scenes = tuple(as_room(one) for one in still)
    for i, planned in enumerate(still):
        seen, reflectivity = scenes.clean(i)
        depth, shade = render(planned.scene, scenes.optics.intrinsics, scenes.times())
        same = np.isclose(seen, depth, atol=1e-5, equal_nan=True) & (reflectivity == shade)
        assert same.mean() > 0.98, planned.name  # A pixel on an edge may see either side.


def test_information_is_between_nothing_and_all() -> None:
    equal = np.full(4, 0.25)
    assert entropy(equal) == 2
    assert information(np.zeros((4, 3, 4)), equal) == 0
    apart = np.repeat(1e4 * (1 - np.eye(4))[:, None], 3, axis=1)
    assert information(apart, equal) == pytest.approx(2.0)
    # Only the first is told from the others.
    first = np.arange(4) == 0
    one_apart = np.repeat(1e4 * (first[:, None] != first)[:, None], 3, axis=1)
    assert information(one_apart, equal) == pytest.approx(2 - 0.75 * np.log2(3))
    # What is believed wrongly is no information.
    assert information(1e4 - apart, equal) == 0
    # Nothing is to be learned about what is certain.
    assert information(apart, np.array([1.0, 0, 0, 0])) == 0

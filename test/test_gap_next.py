"""Which recording would settle what a diagnosis leaves open."""

from dataclasses import replace
import json
import shutil

from campaigns import all_but, write_diagnosis
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.planning.next_recording import suggest, usual_kinds
from flexx2_sim_ros.gap.planning.plan import read_plan
from flexx2_sim_ros.gap.planning.truths import KINDS, write_recording
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
ALONE = ['--jobs', '1']
LENS = {'intrinsics_error': {'strength': 2.0}}
KEPT = 'intrinsics_error', 'multipath', 'offset', 'amplitude_bias', 'pose_error'


@pytest.fixture(scope='module')
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp('plan') / 'plan.yaml'
    path.write_text(PLAN)
    return read_plan(path)


def record(folder, plan, effects, kind, names):
    """Write two recordings of each named set-up."""
    folder.mkdir()
    for again in range(2):
        for planned in plan.recordings:
            if planned.name in names:
                path = folder / f'{planned.name}{again}.npz'
                write_recording(path, plan, planned, flexx2(), kind, effects, again)
    return folder


SETTINGS = {'usecase': 'Mode_9_30fps', 'pose_prior': [0.01, 0.5]}


@pytest.fixture(scope='module')
def undecided(plan, tmp_path_factory):
    """Return a diagnosis that explains only a part of the gap, and its recordings."""
    folder = tmp_path_factory.mktemp('undecided')
    campaign = record(folder / 'campaign', plan, LENS, KINDS[0], ['frontal', 'corner'])
    table = {
        'verdict': 'partly',
        'effects': [{'name': 'intrinsics_error'}],
        'alternatives': [{'name': 'multipath'}],
        'not_decidable': [],
        'not_considered': [{'name': name} for name in all_but(*KEPT)],
        'recordings': [{'name': one.name, 'used': True} for one in campaign.iterdir()],
    }
    return write_diagnosis(folder / 'diagnosis', LENS, SETTINGS, **table), campaign


def test_the_suggestion_settles_what_was_open(plan, undecided, tmp_path, capsys):
    diagnosis, campaign = undecided
    out, own = tmp_path / 'out', tmp_path / 'own <b>.npz'
    with np.load(campaign / 'frontal0.npz') as archive:
        np.savez(own, clean_depth=archive['clean_depth'], K=archive['K'])
    (tmp_path / 'plan.yaml').write_text(PLAN)
    words = ['gap', 'next', str(diagnosis), str(campaign), '--out', str(out), *ALONE]
    words += ['--plan', str(tmp_path / 'plan.yaml'), '--scene', str(own)]
    assert main(words) == 0
    table = json.loads((out / 'next.json').read_text())
    first = list(table['explanations'])[0]
    assert first == 'intrinsics error + multipath'
    assert 'no effect' in table['explanations']
    # A gap was found, so some effect is there.
    assert table['probabilities']['no effect'] < 1e-3
    assert table['probabilities'][first] == max(table['probabilities'].values())
    rows = {row['name']: row for row in table['ranking']}
    assert set(rows) == {'frontal', 'corner', 'hand', own.name}
    right = [row['right'] for row in table['ranking']]
    assert right == sorted(right, reverse=True)
    for row in [*rows.values(), *table['baselines'].values(), table['suggestion']]:
        assert row['right'] + row['wrong'] + row['undecided'] == pytest.approx(1)
    # In a corner light bounces, so multipath would be named first.
    assert rows['corner']['right'] < 0.2
    assert rows['hand']['right'] > 0.8
    assert table['suggestion']['right'] > table['baselines']['repeat']['right']
    page = (out / 'next.html').read_text()
    assert 'own &lt;b&gt;.npz' in page
    assert '<b>' not in page
    # Mean error of each explanation; the set-up of those that the plan has.
    assert page.count('alt="mean error with') == 3 * len(table['explanations'])
    suggested = table['suggestion']['record'][0]['name']
    assert f'set-up of {suggested}' in page
    assert f'Record {suggested}' in ' '.join(capsys.readouterr().err.split())
    # What it says comes true.
    after = tmp_path / 'after'
    names = [row['name'] for row in table['suggestion']['record']]
    record(after, plan, LENS, KINDS[0], names)
    for path in campaign.glob('*.npz'):
        shutil.copy(path, after / f'before_{path.name}')
    settled = diagnose(after, without=all_but(*KEPT))
    assert settled['effects'][0]['name'] == 'intrinsics_error'
    assert all(one['confidence'] < 0.1 for one in settled['alternatives'])


def test_a_laser_decides_what_fitted_planes_leave_open(plan, tmp_path):
    planes = next(one for one in KINDS if one.name == 'planes')
    plan = replace(plan, recordings=plan.recordings[:1])
    campaign = record(tmp_path / 'campaign', plan, {}, planes, ['frontal'])
    # Few effects, so that the test is short. `gap next` leaves out what the diagnosis left out.
    kept = 'pose_error', 'offset', 'amplitude_bias'
    table = diagnose(campaign, without=all_but(*kept), out=tmp_path / 'diagnosis')
    assert 'offset' in [row['name'] for row in table['not_decidable']]
    found, _ = suggest(tmp_path / 'diagnosis', campaign, plan, kinds=['planes', 'laser'])
    assert {'offset', 'no effect'} < set(found['explanations'])
    # Nothing in the recordings says which of them it is.
    assert len(set(found['probabilities'].values())) == 1
    right = {(row['name'], row['truth']): row['right'] for row in found['ranking']}
    assert set(right) == {('frontal', 'planes'), ('frontal', 'laser')}
    assert right['frontal', 'planes'] < right['frontal', 'laser']
    # Where no recording of the plan can be used, a scene of one's own is still ranked.
    own = tmp_path / 'own.npz'
    frames = np.arange(20) / 30
    np.savez(
        own,
        clean_depth=np.full((43, 56), 1.5),
        K=np.array([[52.0, 0, 28], [0, 52.0, 21], [0, 0, 1]]),
        # As a recording of a still scene has it.
        stamp=frames,
        received=frames + 0.02,
        uptime=frames + 100,
        known=np.ones((20, 43, 56), bool),
        clean_sigma=np.full((20, 43, 56), 0.002),
    )
    alone = replace(plan, recordings=())
    found, _ = suggest(tmp_path / 'diagnosis', campaign, alone, scenes=[own])
    assert [row['name'] for row in found['ranking']] == ['own.npz']
    assert list(found['baselines']) == ['repeat']


def test_kinds_of_truth_follow_from_the_recordings():
    def kinds(**truth):
        return usual_kinds({'recordings': [{'used': True, 'truth': truth}, {'used': False}]})

    assert kinds(planes=3, pose=None) == ['tape', 'laser']
    assert kinds(planes=0, pose=0.001) == ['scan']
    assert kinds(planes=0, pose=None) == ['exact']


@pytest.mark.parametrize(
    ('changed', 'said'),
    [
        ({}, 'must leave something open'),
        ({'verdict': 'none', 'effects': []}, 'must have alternatives'),
    ],
)
def test_a_diagnosis_that_leaves_nothing_open_is_refused(changed, said, plan, tmp_path):
    table = {'effects': [{'name': 'multipath', 'parameters': {'gain': 1.0}}], 'alternatives': []}
    table |= {'not_decidable': [], **changed}
    sure = write_diagnosis(tmp_path / 'sure', {'multipath': {}}, SETTINGS, **table)
    with pytest.raises(InputError, match=said):
        suggest(sure, tmp_path, plan)


def test_what_cannot_be_used_is_said_and_nothing_written(undecided, tmp_path, capsys):
    diagnosis, campaign = undecided
    files = sorted(one.name for one in diagnosis.iterdir())
    own, other = tmp_path / 'own.npz', tmp_path / 'other'
    np.savez(own, clean_depth=np.ones((20, 30)))
    other.mkdir()
    shutil.copy(campaign / 'corner0.npz', other)
    for place, words, says in (
        (campaign, ['--scene', str(own)], 'K: must be in the file'),
        (campaign, ['--truth', 'guess'], '--truth: must be among exact, scan, tape, planes'),
        (tmp_path / 'nowhere', [], 'nowhere'),
        (other, [], "CAMPAIGN: must have the recordings that were diagnosed, got no 'corner1.npz"),
    ):
        assert main(['gap', 'next', str(diagnosis), str(place), *ALONE, *words]) == 2
        assert says in capsys.readouterr().err.replace('\n', ' ')
    assert sorted(one.name for one in diagnosis.iterdir()) == files
